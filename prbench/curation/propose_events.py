"""Proposals for pick events that nobody has annotated yet: when which wrist probably reached something.

A proposal is for a person to confirm at the video, never an event. It looks for what reaching looks like: a wrist that
comes to rest (a minimum of its speed) with the arm stretched out and gaze on it.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, StorageError, UsageError
from prbench.files.storage import atomic_path, sole_writer
from prbench.geometry.skeleton import Joint
from prbench.geometry.timelines import nearest_index
from prbench.readers import AnnotatedByHand, AnnotationLine, RecordingFiles, reader_for
from prbench.readers.discover import usable_readers
from prbench.recording import Recording
from prbench.recording.streams import Side
from prbench.shown import csv_text

_SIDES: tuple[Side, Side] = ("left", "right")
_ARMS = (
    (Joint.LEFT_SHOULDER, Joint.LEFT_ELBOW, Joint.LEFT_WRIST),
    (Joint.RIGHT_SHOULDER, Joint.RIGHT_ELBOW, Joint.RIGHT_WRIST),
)
_SMOOTHING = 0.17  # seconds
_BEFORE = 1.0  # seconds before a minimum in which the wrist must have moved and gaze is looked at
_STARTED = 0.35  # m/s relative to the pelvis; slower wrists did not reach
_BENT = 0.55  # share of the arm's length
_STRETCHED = 0.95
_ON_WRIST = 0.10  # metres between ray and wrist
_FAR_FROM_WRIST = 0.45
_NEAR_HINT = 0.5  # seconds
_WEIGHTS = {"arm": 0.35, "gaze": 0.35, "stop": 0.20, "moved": 0.10}
_HINT_SHARE = 0.5
"""Share of the remaining doubt that a hint takes away."""


@dataclass(frozen=True)
class Candidate:
    """One proposed pick."""

    time: float
    """Seconds on the recording's clock."""
    hand: Side
    confidence: float
    """A number from 0 to 1 that ranks proposals; it is no probability."""
    reason: str
    """Hints that speak for it, for the person who decides."""


def propose_pick(recording: Recording, *, hint: float | None = None) -> Candidate | None:
    """The most probable pick of a recording that should hold one.

    Args:
        recording: With a body.
        hint: Time at which the dataset hints at a contact, seconds; the proposal stays within half a second of it.

    Returns:
        None if there is no body, or no wrist ever slows down after moving and there is no hint.
    """
    body = recording.body
    if body is None or int(body.valid.sum()) < 3:
        return None
    times = body.times[body.valid]
    joints = body.joints[body.valid]
    moved = [float(_relative_speed(times, joints, arm[2]).sum()) for arm in _ARMS]
    found = [
        _judged(recording, times, joints, side, int(row), moved[side] >= max(moved))
        for side in (0, 1)
        for row in _stops(times, joints, side)
        if hint is None or abs(times[row] - hint) <= _NEAR_HINT
    ]
    if hint is not None:
        # The best stop near the hint, else the hint itself with the wrist that moved more.
        best = max(found, key=lambda candidate: candidate.confidence, default=None)
        if best is None:
            side = int(np.argmax(moved))
            row = int(nearest_index(body.times[body.valid], np.array([hint]))[0])
            best = _judged(recording, body.times[body.valid], body.joints[body.valid], side, row, True)
        confidence = 1 - (1 - best.confidence) * (1 - _HINT_SHARE)
        apart = best.time - hint
        return Candidate(best.time, best.hand, round(confidence, 2), f"hint {apart:+.2f} s away; {best.reason}")
    return max(found, key=lambda candidate: candidate.confidence, default=None)


def _stops(times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"], side: int) -> Int[np.ndarray, " k"]:
    """Frames at which a wrist, moved before, is slower than around them."""
    speed = _relative_speed(times, joints, _ARMS[side][2])
    inner = np.flatnonzero((speed[1:-1] <= speed[:-2]) & (speed[1:-1] < speed[2:])) + 1
    first = np.searchsorted(times, times[inner] - _BEFORE)
    fast = np.array([speed[start : row + 1].max() for start, row in zip(first, inner, strict=True)])
    return inner[fast >= _STARTED] if len(inner) else inner


def _relative_speed(
    times: Float[np.ndarray, " n"], joints: Float[np.ndarray, "n 22 3"], wrist: int
) -> Float[np.ndarray, " n"]:
    """Speed of a wrist seen from the pelvis, m/s, smoothed."""
    relative = joints[:, wrist] - joints[:, Joint.PELVIS]
    speed = np.linalg.norm(np.gradient(relative, times, axis=0), axis=1)
    # An odd width keeps the smoothed speed centred on its frame.
    width = max(round(_SMOOTHING / float(np.median(np.diff(times)))), 1) | 1
    padded = np.pad(speed, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _judged(
    recording: Recording,
    times: Float[np.ndarray, " n"],
    joints: Float[np.ndarray, "n 22 3"],
    side: int,
    row: int,
    moved_more: bool,
) -> Candidate:
    """Judge how much one stop looks like reaching."""
    shoulder, elbow, wrist = _ARMS[side]
    speed = _relative_speed(times, joints, wrist)
    start = int(np.searchsorted(times, times[row] - _BEFORE))
    arm = np.linalg.norm(joints[row, elbow] - joints[row, shoulder]) + np.linalg.norm(
        joints[row, wrist] - joints[row, elbow]
    )
    stretch = float(np.linalg.norm(joints[row, wrist] - joints[row, shoulder]) / arm)
    look = _nearest_look(recording, joints[row, wrist], times[start], times[row])
    fastest = float(speed[start : row + 1].max())
    marks = {
        "arm": _share(stretch, _BENT, _STRETCHED) * _lifted(joints[row], wrist),
        "gaze": _share(look, _FAR_FROM_WRIST, _ON_WRIST),
        "stop": 1 - min(float(speed[row]) / max(fastest, _STARTED), 1.0),
        "moved": float(moved_more),
    }
    confidence = sum(weight * marks[name] for name, weight in _WEIGHTS.items())
    seen = "no gaze" if np.isinf(look) else f"gaze {look * 100:.0f} cm from the wrist"
    reason = (
        f"{_SIDES[side]} wrist slows from {fastest:.1f} to {speed[row]:.1f} m/s; arm {stretch:.0%} stretched; {seen}"
        + ("; this wrist moves more" if moved_more else "")
    )
    return Candidate(float(times[row]), _SIDES[side], round(confidence, 2), reason)


def _lifted(joints: Float[np.ndarray, "22 3"], wrist: int) -> float:
    """0 for an arm that hangs beside the pelvis, 1 for a wrist 30 cm away from its axis or above the chest."""
    aside = float(np.hypot(*(joints[wrist] - joints[Joint.PELVIS])[[0, 2]]))
    above = float(joints[wrist, 1] - joints[Joint.SPINE3, 1])
    return max(_share(aside, 0.25, 0.40), _share(above, 0.0, 0.1))


def _nearest_look(recording: Recording, point: Float[np.ndarray, "3"], start: float, end: float) -> float:
    """Return the distance of the nearest gaze to a point between two times, metres; infinite without gaze."""
    gaze = recording.gaze
    rows = np.flatnonzero(gaze.valid & (gaze.times >= start) & (gaze.times <= end))
    if len(rows) == 0:
        return float("inf")
    apart = point - gaze.origin[rows]
    along = np.maximum((apart * gaze.direction[rows]).sum(axis=1), 0.0)
    return float(np.linalg.norm(apart - along[:, None] * gaze.direction[rows], axis=1).min())


def _share(value: float, none: float, all_: float) -> float:
    """0 at ``none``, 1 at ``all_``, linear between."""
    return float(np.clip((value - none) / (all_ - none), 0.0, 1.0))


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
