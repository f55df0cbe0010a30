"""``prbench candidates``: a table of proposed events for a person to confirm."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from prbench.curation.candidates import Candidate, propose_pick
from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, StorageError, UsageError
from prbench.locks import sole_writer
from prbench.readers import RecordingFiles, reader_for
from prbench.readers.gimo import format as gimo
from prbench.readers.gimo.segments import row_of
from prbench.shown import csv_text
from prbench.storage import atomic_path

DATASETS = ("gimo",)
"""Datasets whose events a person has to annotate."""
COLUMNS = (*gimo.EVENT_COLUMNS, gimo.CONFIRMED_COLUMN, "confidence", "reason", "activity")

_IN_PROCESS = InProcess()


@dataclass(frozen=True)
class Proposal:
    """The picks proposed in one segment."""

    segment: gimo.Segment
    candidate: Candidate | None
    problem: str = ""
    """The reason why the segment could not be read; empty for those that were."""

    def row(self) -> dict[str, object]:
        """The line of the table; a segment without a proposal has one too, for a person to fill in."""
        segment, found = self.segment, self.candidate
        return {
            "scene": segment.scene,
            "sequence_path": segment.sequence,
            "start_frame": segment.start_frame,
            "end_frame": segment.end_frame,
            "event_frame": "" if found is None else round(found.time * gimo.FRAME_RATE),
            "action": "pick",
            "hand": "" if found is None else found.hand,
            gimo.CONFIRMED_COLUMN: "",
            "confidence": "" if found is None else f"{found.confidence:.2f}",
            "reason": self.problem or ("nothing looks like reaching" if found is None else found.reason),
            "activity": segment.activity,
        }


def write_candidates(
    dataset: str,
    root: Path,
    out: Path,
    *,
    options: Mapping[str, str] | None = None,
    engine: Engine = _IN_PROCESS,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[Proposal, ...]:
    """Propose one event a segment and write them as a table that the reader ignores until a person confirms lines.

    Args:
        dataset: ``gimo``.
        root: Its folder.
        out: A file that does not exist yet: annotations are never overwritten.
        options: Options of the reader.
        engine: Where segments are read.
        progress: Called after each segment.

    Raises:
        UsageError: for a dataset whose events are not annotated by hand.
        StorageError: if ``out`` exists or cannot be written.
        InputFileError: if there is nothing to read.
    """
    if dataset not in DATASETS:
        raise UsageError(
            f"events of '{dataset}' need no annotation by hand; candidates are for: {', '.join(DATASETS)}."
        )
    with sole_writer(out):
        if out.exists():
            raise StorageError(
                f"{out}: exists already, and annotations are never overwritten. Name another file, and merge the two."
            )
        found = reader_for(dataset, options).find(root)
        proposals = []
        for proposal in engine.map(Proposer(dataset, tuple(sorted((options or {}).items()))), found):
            proposals.append(proposal)
            if progress is not None:
                progress(len(proposals), len(found), proposal.segment.name)
        _write(out, proposals)
    return tuple(proposals)


@dataclass(frozen=True)
class Proposer:
    """Reads one segment and proposes its pick."""

    dataset: str
    options: tuple[tuple[str, str], ...]

    def __call__(self, found: RecordingFiles) -> Proposal:
        """Read and propose; a segment that cannot be read keeps its line with the reason."""
        segment = row_of(found)[0].segment
        try:
            recording = reader_for(self.dataset, dict(self.options)).read(found)
        except PrbenchError as error:
            return Proposal(segment, None, f"not read: {error}")
        hint = None if segment.hint is None else segment.hint / gimo.FRAME_RATE
        return Proposal(segment, propose_pick(recording, hint=hint))


def _write(path: Path, proposals: Iterable[Proposal]) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for proposal in proposals:
            row = proposal.row()
            writer.writerow([csv_text(row[name]) for name in COLUMNS])
