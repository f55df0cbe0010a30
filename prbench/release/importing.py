"""Import the authors' release: sequences in the stated layout become tables; what it leaves open is written down.

Arrays are read twice, so that memory does not grow with the motions: to check and measure them, and to convert them.
"""

from __future__ import annotations

import json
import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from prbench.entry_points import STUDY_ITEMS, load_built_in
from prbench.errors import InputFileError, RecordingsWouldBeLost
from prbench.files.bounded import foreign_input
from prbench.files.storage import file_digest, require_replaceable, sole_writer, text_digest
from prbench.geometry.skeleton import WRISTS, Joint, invert_rigid, transform_points
from prbench.protocol.manifests import Manifest, digest_of, load_citations, load_manifest, load_protocol
from prbench.release import layout, reading
from prbench.release.report import ImportReleaseReport, ImportReport
from prbench.sequences import DatasetInfo, Event, Recording, Sequence, SequenceTable
from prbench.sequences.dataset_info import FILE_NAME, FunnelCounts, begun_with, quarantined, strictest
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.sequences.sequence import OUTCOMES, event_batch, recording_batch, sequence_batch
from prbench.sequences.table import body_movement, hand_movement
from prbench.sequences.write import write_dataset

_POSE_SOURCE = "release"
_UNKNOWN_ACTION = "unknown"
_HANDS = ("left", "right")  # in the order of WRISTS
_PICKS = re.compile(r"\b(pick|grab|take|taking|took|lift|fetch)", re.IGNORECASE)
_PUTS = re.compile(r"\b(put|plac|drop|set(s|ting)? down|return)", re.IGNORECASE)


def make_row(found: reading.ReleasedDataset, one: reading.ReleasedSequence, *, head_tilt_deg: float) -> Sequence:
    """Read one sequence again and convert it; times count from the first frame.

    Args:
        found: The dataset that it belongs to.
        one: The sequence, measured.
        head_tilt_deg: Rest tilt of the neck-head bone of the dataset's bodies, degrees.

    Raises:
        InputFileError: if its files changed since they were measured.
    """

    def value(canonical: str) -> str:
        stated = found.value(one.fields, canonical)
        return stated.strip() if isinstance(stated, str) else ""

    # Motion, goal and gaze come into the canonical frame by one and the same transform.
    joints = layout.read_array(one.motion, (22, 3)).astype(np.float64)
    gaze = None if one.gaze is None else layout.read_array(one.gaze, (3,))
    directions, valid = reading.clean_gaze(gaze, len(joints))
    canonical_from_motion = invert_rigid(one.motion_from_canonical)
    goal = transform_points(canonical_from_motion, one.goal)
    if (one.motion_from_canonical != np.eye(4)).any():  # a canonical motion keeps every bit
        turn = canonical_from_motion.copy()
        turn[:3, 3] = 0.0
        joints = transform_points(canonical_from_motion, joints)
        directions = transform_points(turn, directions)
    text = value("text")
    action = _UNKNOWN_ACTION
    for words in (text, value("action")):  # what is stated outweighs the prompt
        picks = bool(_PICKS.search(words))
        if picks != bool(_PUTS.search(words)):  # `take the cup and put it down` names both
            action = "pick" if picks else "put"
    if not text and action != _UNKNOWN_ACTION:
        text = load_protocol().text["pick" if action == "pick" else "put"]
    hand = value("hand").lower()
    # Where no field names the hand, the nearer wrist is taken for the one that reached.
    wrist = WRISTS[int(np.linalg.norm(joints[-1, WRISTS] - goal, axis=1).argmin())]
    if hand in _HANDS:
        wrist = WRISTS[_HANDS.index(hand)]
    # The release has no ids of objects, and counts whole frames from the beginning of a sequence.
    dataset = found.report.dataset
    about: dict[str, Any] = {"dataset": dataset, "pose_source": _POSE_SOURCE, "head_tilt_deg": head_tilt_deg}
    about |= {"recording_id": one.source, "participant_id": reading.UNKNOWN, "split_group": one.source}
    about |= {"split": one.subset, "object_id": "", "object_name": value("object_name"), "text": text}
    event_time = (len(joints) - 1) / found.fps
    prime_time = one.primed_frame / found.fps
    about |= {"fps": found.fps, "n_frames": len(joints), "start_time": 0.0, "event_time": event_time}
    about |= {"prime_frame": one.primed_frame, "prime_time": prime_time, "preroll": prime_time}
    about |= {"prime_kind": "unknown", "prime_time_uncertainty": 1 / found.fps}
    kept = {name: one.fields[name] for name in found.report.fields_kept_in_extra if name in one.fields}
    return Sequence(
        **about,
        sequence_id=f"{dataset}/{one.index:010d}/{_POSE_SOURCE}",
        action=action,
        hand=hand if hand in _HANDS else None,
        prime_gap=event_time - prime_time,
        goal_location=goal,
        **dict[str, Any].fromkeys(("goal_box_world_min", "goal_box_world_max"), one.goal),
        body_movement=body_movement(joints),
        hand_movement=hand_movement(joints, wrist),
        joints=joints,
        previous_joints=2 * joints[0] - joints[1],
        next_joints=2 * joints[-1] - joints[-2],
        **dict[str, Any].fromkeys(("previous_source", "next_source"), "extrapolated"),
        **dict[str, Any].fromkeys(("head_position", "head_rotation"), None),
        gaze_origin=joints[:, Joint.HEAD],
        gaze_direction=directions,
        gaze_valid=valid,
        world_from_canonical=one.motion_from_canonical,
        extra={name: each if isinstance(each, str) else json.dumps(each) for name, each in kept.items()},
    )


def _event(sequence: Sequence) -> Event:
    same = ("recording_id", "sequence_id", "object_id", "object_name", "action", "hand", "event_time", "prime_time",
            "prime_kind")  # fmt: skip
    about: dict[str, Any] = {name: getattr(sequence, name) for name in same}
    about |= {"box_min": sequence.goal_box_world_min, "box_max": sequence.goal_box_world_max}
    location = transform_points(sequence.world_from_canonical, sequence.goal_location)
    name = sequence.sequence_id.rsplit("/", 1)[0]
    return Event(event_id=name, **about, location=location, outcome="sequence", stage="filters")


NO_OPTIONS = reading.ImportOptions()
_ROWS = 64  # sequences that are converted at once
_STUDY_TERMS = "Prime and Reach release (its page states no licence known to prbench; ask its authors)"
# Our assumption, since the study states no terms of its own contribution: the terms of most of its datasets.
_STUDY_REDISTRIBUTION = "non-commercial"


@foreign_input()
def import_release(
    root: Path | str,
    out: Path | str,
    *,
    dataset: str | None = None,
    options: reading.ImportOptions = NO_OPTIONS,
    progress: reading.Progress = lambda _dataset, _step: None,
) -> ImportReleaseReport:
    """Turn a release into sequence tables.

    Args:
        root: The release (folders HD-EPIC, MoGaze …), or the folder of one dataset.
        out: The table's folder if ``dataset`` is given, else a folder in which each dataset gets one of its own.
        dataset: Name of the only dataset to import.
        options: Statements of the user.
        progress: Called with the dataset and the step that begins.

    Raises:
        InputFileError: if there is nothing to import; with ``on_error="fail"`` for the first thing that is wrong.
        UsageError: for an unknown dataset or field name.
        StorageError: if ``out`` cannot be written or holds something else.
        RecordingsWouldBeLost: if the one dataset's table that stands there holds more, and the options do not say to
            replace it.
    """
    root = Path(root)
    out = Path(out)
    if dataset is not None:
        dataset = layout.dataset_of(dataset) or dataset  # users may write it as the authors do: HD-EPIC
    found = layout.find_datasets(root, dataset)
    targets = {name: out if dataset is not None else out / name for name, _ in found}
    for target in targets.values():
        # Before anything is read: a folder that holds something else must not be noticed after an hour.
        require_replaceable(target, FILE_NAME, kind="dataset")
    # Messages end with this command and what has to be added to it.
    named = [] if dataset is None else ["--dataset", dataset]
    named += [] if options.fps is None else ["--fps", f"{options.fps:g}"]
    command = f"prbench import-release {shlex.join([str(root), '--out', str(out), *named])}"
    tables = []
    failed = {}
    for name, folder in found:
        try:
            with sole_writer(targets[name]):
                tables.append(_import_dataset(name, folder, targets[name], options, progress, command))
        except (InputFileError, RecordingsWouldBeLost) as error:
            if options.on_error == "fail" or len(found) == 1:
                raise
            failed[name] = str(error)
    opened = [SequenceTable.open(table.folder) for table in tables]
    sizes = load_built_in(STUDY_ITEMS, "sizes")(opened) if opened else []
    return ImportReleaseReport(tables=tables, failed=failed, sizes=sizes)


@foreign_input()
def _import_dataset(
    dataset: str, folder: Path, out: Path, options: reading.ImportOptions, progress: reading.Progress, command: str
) -> ImportReport:
    manifest = load_manifest(dataset)
    exported = layout.read_export_record(folder)
    report = ImportReport(dataset=dataset, folder=out)
    found = reading.read_release(report, folder, options, progress, command)
    # Tables are sorted by id, so that a release in another order gives the same bytes.
    found.sequences.sort(key=lambda one: f"{one.index:010d}")
    progress(dataset, f"writing {len(found.sequences)} sequences")
    # Source recordings where the release names them, else one unknown recording for each split.
    sequences_of: dict[str, list[reading.ReleasedSequence]] = defaultdict(list)
    for one in found.sequences:
        sequences_of[one.source].append(one)
    records = []
    for name, rows in sorted(sequences_of.items()):
        splits = Counter(row.subset for row in rows)
        message = ""
        if len(splits) > 1:
            message = "its sequences stand in more than one split"
        elif name == f"unknown-{rows[0].subset}":
            message = "the release does not say which recording a sequence comes from"
        # A recording has one split in our tables: the commoner one, where a release mixes them.
        split = splits.most_common(1)[0][0]
        about = (name, reading.UNKNOWN, split, name, sum((row.n_frames - 1) / found.fps for row in rows))
        records.append(Recording(*about, {"sequence": len(rows)}, "read", message))
    for key, reason in sorted(report.reasons.items()):
        records.append(Recording(f"sequence {key}", reading.UNKNOWN, "", "", 0.0, {}, "failed", reason))
    events: list[Event] = []

    def sequence_rows() -> Iterator[pa.RecordBatch]:
        for start in range(0, len(found.sequences), _ROWS):
            chosen = found.sequences[start : start + _ROWS]
            made = [make_row(found, one, head_tilt_deg=manifest.body.head_tilt_deg) for one in chosen]
            events.extend(map(_event, made))
            yield sequence_batch(made)

    info = write_dataset(
        out,
        _describe(found, records, manifest, terms_of(dataset, manifest, exported)),
        sequences=sequence_rows(),
        events=(event_batch(each) for each in (events,)),  # made when it is asked for, after all sequences were written
        recordings=[recording_batch(records)],
        replace=options.replace,
        incomplete=[each.recording_id for each in records] if report.left_out else (),
    )
    report.title = info.title
    report.why_not_scored = info.why_not_scored
    report.write()
    return report


def terms_of(dataset: str, manifest: Manifest, exported: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return title, licence, redistribution, homepage, citation and ``synthetic`` of an imported dataset.

    Data that our exporter wrote are no part of the study's release; what its record says can make terms stricter than
    the manifest's, never looser.
    """
    synthetic = dataset.startswith(layout.SYNTHETIC_PREFIX)
    terms = manifest.terms(synthetic=synthetic)
    if synthetic:
        return terms
    if exported is not None:
        # The record lies beside the data and anybody can edit it, so it may only make the terms stricter.
        stated = str(exported.get("redistribution", manifest.redistribution))
        return terms | {"redistribution": strictest([manifest.redistribution, stated])}
    return terms | {
        "title": f"{manifest.title}, as released with Prime and Reach",
        "licence": f"{manifest.licence} (source recordings); {_STUDY_TERMS}",
        "redistribution": strictest([manifest.redistribution, _STUDY_REDISTRIBUTION]),
        "citation": f"{load_citations()['study'].strip()}\n\n{terms['citation']}",
    }


def _describe(
    found: reading.ReleasedDataset, records: list[Recording], manifest: Manifest, terms: Mapping[str, Any]
) -> DatasetInfo:
    """Describe an import: every inference stands among its options; the writer fills in the digests."""
    protocol = load_protocol()
    n = len(found.sequences)
    failed = sum(record.status == "failed" for record in records)
    options = {"source": "release", "in_hand_rule": "the release's own events"}
    for each in found.report.inferred:
        options[f"release.{each.name}"] = f"{each.value} ({each.how_surely}: {each.evidence})"
        if each.name == "goal_frame":
            options["goal_frame"] = each.value  # which decides whether the table may be scored
    options |= {f"release.field.{canonical}": name for canonical, name in found.report.fields.items()}
    arrays = [text for one in found.sequences for text in (str(one.index), one.digest)]
    # A release holds sequences alone, so every event has passed all stages.
    counts = dict.fromkeys(("events", "located", "primed", "long_enough", "moved_enough", "sequences"), n)
    counts |= {"recordings_found": len(records), "recordings_read": len(records) - failed}
    counts |= {"recordings_failed": failed, "recordings_skipped": 0}
    return DatasetInfo(
        schema_version=SCHEMA_VERSION,
        **begun_with(protocol),
        dataset=found.report.dataset,
        manifest_digest=digest_of(manifest),
        input_digest=text_digest(file_digest(found.folder / layout.TARGETS), *arrays),
        options=options,
        counts=FunnelCounts(**counts),
        outcomes=dict.fromkeys(OUTCOMES, 0) | {"sequence": n},
        quarantine=quarantined(records),
        **terms,
    )
