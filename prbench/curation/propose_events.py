"""``prbench build-dataset --propose-events``: a table of proposed events for a person to confirm."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from prbench.curation.candidates import Candidate, propose_pick
from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, StorageError, UsageError
from prbench.files.storage import atomic_path, sole_writer
from prbench.readers import AnnotatedByHand, AnnotationLine, RecordingFiles, reader_for
from prbench.readers.discover import usable_readers
from prbench.shown import csv_text

_IN_PROCESS = InProcess()


@dataclass(frozen=True)
class Proposal:
    """The picks proposed in one recording."""

    line: AnnotationLine
    candidate: Candidate | None
    problem: str = ""
    """The reason why the recording could not be read; empty for those that were."""

    def row(self) -> dict[str, object]:
        """The line of the table; a recording without a proposal has one too, for a person to fill in."""
        found = self.candidate
        return {
            **self.line.cells,
            "event_frame": "" if found is None else round(found.time * self.line.frame_rate),
            "action": "pick",
            "hand": "" if found is None else found.hand,
            "confidence": "" if found is None else f"{found.confidence:.2f}",
            "reason": self.problem or ("nothing looks like reaching" if found is None else found.reason),
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
        dataset: One whose events are annotated by hand.
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
    reader = _reader(dataset, options)
    # Taken before the segments are read, so that two processes cannot both find the file missing.
    with sole_writer(out):
        if out.exists():
            raise StorageError(
                f"{out}: exists already, and annotations are never overwritten. Name another file, and merge the two."
            )
        found = reader.find(root)
        proposals = []
        for proposal in engine.map(Proposer(dataset, tuple(sorted((options or {}).items()))), found):
            proposals.append(proposal)
            if progress is not None:
                progress(len(proposals), len(found), proposal.line.recording_id)
        _write(out, reader.annotation_columns, proposals)
    return tuple(proposals)


@dataclass(frozen=True)
class Proposer:
    """Reads one recording and proposes its pick."""

    dataset: str
    options: tuple[tuple[str, str], ...]

    def __call__(self, found: RecordingFiles) -> Proposal:
        """Read and propose; a recording that cannot be read keeps its line with the reason."""
        reader = _reader(self.dataset, dict(self.options))
        # Made before the recording is read, because a recording that cannot be read has a line too.
        line = reader.annotation_line(found)
        try:
            recording = reader.read(found)
        except PrbenchError as error:
            return Proposal(line, None, f"not read: {error}")
        return Proposal(line, propose_pick(recording, hint=line.hint))


def _reader(dataset: str, options: Mapping[str, str] | None) -> AnnotatedByHand:
    reader = reader_for(dataset, options)
    if not isinstance(reader, AnnotatedByHand):
        others = [each.dataset for each in usable_readers()[0] if isinstance(each, AnnotatedByHand)]
        raise UsageError(f"events of '{dataset}' need no annotation by hand; proposals are for: {', '.join(others)}.")
    return reader


def _write(path: Path, columns: tuple[str, ...], proposals: Iterable[Proposal]) -> None:
    with atomic_path(path) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for proposal in proposals:
            row = proposal.row()
            # People open this table in spreadsheets, which would take some names for formulas.
            writer.writerow([csv_text(row[name]) for name in columns])
