"""Proposals for pick events that nobody has annotated yet: when which wrist probably reached something.

A proposal is for a person to confirm at the video, never an event. It looks for what reaching looks like: a wrist that
comes to rest (a minimum of its speed) with the arm stretched out and gaze on it.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.engine import Engine, InProcess
from prbench.errors import PrbenchError, StorageError, UsageError
from prbench.files.storage import atomic_path, sole_writer
from prbench.geometry.skeleton import CHAINS, Joint
from prbench.geometry.timelines import nearest_index
from prbench.progress_bar import ProgressCallback
from prbench.readers import AnnotatedByHand, RecordingFiles, reader_for
from prbench.readers.discover import usable_readers
from prbench.recording import SIDES, Recording, Side
from prbench.shown import csv_text

Times = Float[np.ndarray, " n"]
Joints = Float[np.ndarray, "n 22 3"]

_ARMS = (CHAINS[4][2:], CHAINS[3][2:])  # left and right: shoulder, elbow, wrist
_SMOOTHING = 0.17  # seconds
_BEFORE = 1.0  # seconds before a minimum in which the wrist must have moved and gaze is looked at
_STARTED = 0.35  # m/s relative to the pelvis; slower wrists did not reach
_BENT = 0.55  # share of the arm's length
_STRETCHED = 0.95
_ON_WRIST = 0.10  # metres between ray and wrist
_FAR_FROM_WRIST = 0.45
_NEAR_HINT = 0.5  # seconds
_WEIGHTS = {"arm": 0.35, "gaze": 0.35, "stop": 0.20, "moved": 0.10}
# Share of the remaining doubt that a hint takes away.
_HINT_SHARE = 0.5


@dataclass(frozen=True)
class Candidate:
    """One proposed pick.

    Attributes:
        time: Seconds on the recording's clock.
        hand: The hand that probably reached.
        confidence: A number from 0 to 1 that ranks proposals; it is no probability.
        reason: Hints that speak for it, for the person who decides.
    """

    time: float
    hand: Side
    confidence: float
    reason: str


def propose_pick(recording: Recording, *, hint: float | None = None) -> Candidate | None:
    """Return the most probable pick of a recording that should hold one.

    Args:
        recording: A recording that has a body.
        hint: Time at which the dataset hints at a contact, seconds; the proposal stays within half a second of it.

    Returns:
        None if there is no body, or no wrist ever slows down after moving and there is no hint.
    """
    body = recording.body
    if body is None or int(body.valid.sum()) < 3:
        return None
    times = body.times[body.valid]
    joints = body.joints[body.valid]
    # Frames at which a wrist, moved before, is slower than around them.
    speeds = [_relative_speed(times, joints, arm[2]) for arm in _ARMS]
    moved = [float(speed.sum()) for speed in speeds]
    found = []
    for side, speed in enumerate(speeds):
        inner = np.flatnonzero((speed[1:-1] <= speed[:-2]) & (speed[1:-1] < speed[2:])) + 1
        for start, row in zip(np.searchsorted(times, times[inner] - _BEFORE).tolist(), inner.tolist(), strict=True):
            near = hint is None or abs(times[row] - hint) <= _NEAR_HINT
            if near and speed[start : row + 1].max() >= _STARTED:
                found.append(_judged(recording, times, joints, side, row, moved[side] >= max(moved)))
    best = max(found, key=lambda candidate: candidate.confidence, default=None)
    if hint is None:
        return best
    # The best stop near the hint, else the hint itself with the wrist that moved more.
    if best is None:
        row = int(nearest_index(times, np.array([hint]))[0])
        best = _judged(recording, times, joints, int(np.argmax(moved)), row, True)
    reason = f"hint {best.time - hint:+.2f} s away; {best.reason}"
    return Candidate(best.time, best.hand, round(1 - (1 - best.confidence) * (1 - _HINT_SHARE), 2), reason)


def _relative_speed(times: Times, joints: Joints, wrist: int) -> Times:
    """Speed of a wrist seen from the pelvis, m/s, smoothed."""
    speed = np.linalg.norm(np.gradient(joints[:, wrist] - joints[:, Joint.PELVIS], times, axis=0), axis=1)
    # An odd width keeps the smoothed speed centred on its frame.
    width = max(round(_SMOOTHING / float(np.median(np.diff(times)))), 1) | 1
    return np.convolve(np.pad(speed, width // 2, mode="edge"), np.full(width, 1 / width), mode="valid")


def _judged(recording: Recording, times: Times, joints: Joints, side: int, row: int, moved_more: bool) -> Candidate:
    """Judge how much one stop looks like reaching."""
    shoulder, elbow, wrist = (joints[row, joint] for joint in _ARMS[side])
    speed = _relative_speed(times, joints, _ARMS[side][2])
    start = int(np.searchsorted(times, times[row] - _BEFORE))
    fastest = float(speed[start : row + 1].max())
    arm = np.linalg.norm(elbow - shoulder) + np.linalg.norm(wrist - elbow)
    stretch = float(np.linalg.norm(wrist - shoulder) / arm)
    # 0 for an arm that hangs beside the pelvis, 1 for a wrist 40 cm away from its axis or above the chest.
    aside = float(np.hypot(*(wrist - joints[row, Joint.PELVIS])[[0, 2]]))
    lifted = max(_share(aside, 0.25, 0.40), _share(float(wrist[1] - joints[row, Joint.SPINE3, 1]), 0.0, 0.1))
    # Distance of the nearest gaze to the wrist, metres; infinite without gaze.
    gaze = recording.gaze
    rows = np.flatnonzero(gaze.valid & (gaze.times >= times[start]) & (gaze.times <= times[row]))
    apart = wrist - gaze.origin[rows]
    along = np.maximum((apart * gaze.direction[rows]).sum(axis=1), 0.0)
    look = float(np.linalg.norm(apart - along[:, None] * gaze.direction[rows], axis=1).min(initial=np.inf))
    marks = {
        "arm": _share(stretch, _BENT, _STRETCHED) * lifted,
        "gaze": _share(look, _FAR_FROM_WRIST, _ON_WRIST),
        "stop": 1 - min(float(speed[row]) / max(fastest, _STARTED), 1.0),
        "moved": float(moved_more),
    }
    confidence = sum(weight * marks[name] for name, weight in _WEIGHTS.items())
    seen = "no gaze" if np.isinf(look) else f"gaze {look * 100:.0f} cm from the wrist"
    more = "; this wrist moves more" if moved_more else ""
    slows = f"{SIDES[side]} wrist slows from {fastest:.1f} to {speed[row]:.1f} m/s"
    reason = f"{slows}; arm {stretch:.0%} stretched; {seen}{more}"
    return Candidate(float(times[row]), SIDES[side], round(confidence, 2), reason)


def _share(value: float, none: float, all_: float) -> float:
    """0 at ``none``, 1 at ``all_``, linear between."""
    return float(np.clip((value - none) / (all_ - none), 0.0, 1.0))


_IN_PROCESS = InProcess()


def write_candidates(
    dataset: str,
    root: Path,
    out: Path,
    *,
    options: Mapping[str, str] | None = None,
    engine: Engine = _IN_PROCESS,
    progress: ProgressCallback | None = None,
) -> tuple[list[dict[str, object]], dict[str, str]]:
    """Propose one event a segment and write them as a table that the reader ignores until a person confirms lines.

    Args:
        dataset: One whose events are annotated by hand.
        root: Its folder.
        out: A file that does not exist yet: annotations are never overwritten.
        options: Options of the reader.
        engine: Reads the segments, in this process or in others.
        progress: Called after each segment.

    Returns:
        The rows of the table, and for each recording that could not be read the reason.

    Raises:
        UsageError: for a dataset whose events are not annotated by hand.
        StorageError: if ``out`` exists or cannot be written.
        InputFileError: if there is nothing to read.
    """
    reader = _reader(dataset, options)
    # Taken before the segments are read, so that two processes cannot both find the file missing.
    with sole_writer(out):
        if out.exists():
            problem = f"{out}: exists already, and annotations are never overwritten."
            raise StorageError(f"{problem} Name another file, and merge the two.")
        found = reader.find(root)
        rows = []
        problems = {}
        for name, row, problem in engine.map(partial(_proposed, dataset, dict(options or {})), found):
            rows.append(row)
            if problem:
                problems[name] = problem
            if progress is not None:
                progress(len(rows), len(found), name)
        with atomic_path(out) as temporary, open(temporary, "w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(reader.annotation_columns)
            for row in rows:
                # People open this table in spreadsheets, which would take some names for formulas.
                writer.writerow([csv_text(row[name]) for name in reader.annotation_columns])
    return rows, problems


def _proposed(dataset: str, options: Mapping[str, str], found: RecordingFiles) -> tuple[str, dict[str, object], str]:
    """Read one recording and propose its pick: its name, its line of the table, and why it could not be read."""
    reader = _reader(dataset, options)
    # Made before the recording is read, because a recording that cannot be read has a line too, for a person to fill.
    line = reader.annotation_line(found)
    pick = None
    problem = ""
    try:
        pick = propose_pick(reader.read(found), hint=line.hint)
    except PrbenchError as error:
        problem = f"not read: {error}"
    row = {"event_frame": "", "hand": "", "confidence": "", "reason": problem or "nothing looks like reaching"}
    if pick is not None:
        row = {"event_frame": round(pick.time * line.frame_rate), "hand": pick.hand, "reason": pick.reason}
        row["confidence"] = f"{pick.confidence:.2f}"
    return line.recording_id, {**line.cells, "action": "pick", **row}, problem


def _reader(dataset: str, options: Mapping[str, str] | None) -> AnnotatedByHand:
    reader = reader_for(dataset, options)
    if not isinstance(reader, AnnotatedByHand):
        others = [each.dataset for each in usable_readers()[0] if isinstance(each, AnnotatedByHand)]
        raise UsageError(f"events of '{dataset}' need no annotation by hand; proposals are for: {', '.join(others)}.")
    return reader
