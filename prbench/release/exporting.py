"""Write sequence tables in the layout of the authors' release, for others' tools and to try an import."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import prbench
from prbench.errors import UsageError
from prbench.files.storage import atomic_folder, inside, require_replaceable, sole_writer, write_json
from prbench.release import layout
from prbench.release.report import ExportedTable, ExportReleaseReport
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import NOTICE_FILE, notice, require_may_pass_on
from prbench.sequences.sequence import sequences_in


def export_release(
    tables: Sequence[Path | str], out: Path | str, *, permitted: Collection[str] = (), as_published: bool = False
) -> ExportReleaseReport:
    """Write tables as a release: ``out/<DATASET>/motions``, ``gazes`` and ``target_information.json``.

    Motions, goals and gazes are in the canonical frame of each sequence.

    Args:
        tables: Dataset folders, of different datasets.
        out: The release; a dataset's folder that an earlier export wrote is replaced, anything else is not touched.
        permitted: Datasets whose licence keeps recorded motion, but for which the user has permission.
        as_published: Leave out the fields that the authors' page does not name: its four fields and nothing else.

    Raises:
        RedistributionError: if a licence forbids it; nothing is written then.
        UsageError: for two tables of one dataset.
        TableError: if a table is missing or damaged.
        StorageError: if ``out`` cannot be written or holds something else.
    """
    out = Path(out)
    opened = [SequenceTable.open(folder).with_sequences() for folder in tables]
    names = [layout.folder_of(table.info.dataset) for table in opened]
    folders = [inside(out, name) for name in names]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two tables are of {name}; a release has one folder a dataset.")
    for table, folder in zip(opened, folders):
        # All tables are checked before the first is written: a refusal leaves nothing behind.
        require_may_pass_on(table.info, "a release", permitted)
        require_replaceable(folder, layout.EXPORT_RECORD, kind="export")
    written = []
    for table, folder in zip(opened, folders):
        info = table.info
        said = notice(info, permitted)
        with sole_writer(folder), atomic_folder(folder) as temporary:
            for name in (layout.MOTIONS, layout.GAZES):
                (temporary / name).mkdir()
            count = 0
            with open(temporary / layout.TARGETS, "w", encoding="utf-8", newline="\n") as file:
                for count, (key, entry) in enumerate(_written(table, temporary, as_published), 1):
                    # One entry a line, written as it comes: the file of a large table never stands in memory.
                    line = json.dumps(entry, ensure_ascii=False, allow_nan=False)
                    file.write(f"{'{' if count == 1 else ','}\n{json.dumps(key)}: {line}")
                file.write("\n}\n")
            same = ("dataset", "title", "licence", "redistribution", "homepage", "citation", "identity_digest",
                    "content_digest")  # fmt: skip
            record = {"written_by": f"prbench {prbench.__version__}"} | {name: getattr(info, name) for name in same}
            record |= {"permission_stated": info.dataset in permitted, "frame": "canonical"}
            write_json(temporary / layout.EXPORT_RECORD, record)
            if said:
                text = f"{said}\n\nLicence: {info.licence}\n{info.homepage}\n\n{info.citation}\n"
                (temporary / NOTICE_FILE).write_text(text, encoding="utf-8")
        written.append(ExportedTable(dataset=info.dataset, folder=folder, sequences=count, notice=said))
    return ExportReleaseReport(datasets=written)


def _written(table: SequenceTable, folder: Path, as_published: bool) -> Iterator[tuple[str, dict[str, Any]]]:
    """Write the arrays of every sequence and yield its key and entry."""
    rows = (sequence for chunk in table.chunks(rows=64) for sequence in sequences_in(chunk.batch))
    for index, sequence in enumerate(rows):
        key = f"{index:010d}"
        # The layout has no column of validity, so NaN has to say it.
        gaze = np.where(sequence.gaze_valid[:, None], sequence.gaze_direction, np.float32(np.nan))
        for name, values in ((layout.MOTIONS, sequence.joints), (layout.GAZES, gaze)):
            np.save(folder / name / f"{key}.npy", np.ascontiguousarray(values, dtype=np.float32), allow_pickle=False)
        fields: dict[str, Any] = {
            "goal_location": sequence.goal_location.tolist(),
            "text_prompt": sequence.text,
            # The study has no validation part: ours belongs to its training sequences.
            "subset": "train" if as_published and sequence.split == "validation" else sequence.split,
            "primed_frame": sequence.prime_frame,
        }
        if not as_published:
            fields |= {"action": sequence.action, "fps": sequence.fps, "source": sequence.recording_id}
            fields |= {"object_name": sequence.object_name, "event_frame": sequence.n_frames - 1}
            fields |= {"units": "m", "up": "y"} | ({"hand": sequence.hand} if sequence.hand else {})
        yield key, fields
