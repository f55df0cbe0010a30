"""Conclude unit, frames and skeleton from measurements (docs/specification/pr-release.md#what-is-unknown)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from prbench.errors import InputFileError
from prbench.release.known import load_known
from prbench.release.report import Inference
from prbench.release.survey import GOAL_FRAMES, Measured, mean_bones

UNKNOWN = "unknown"
_UNITS = {"metres": 1.0, "centimetres": 0.01, "millimetres": 0.001}
_UNIT_NAMES = {"m": "metres", "metre": "metres", "meter": "metres", "meters": "metres", "cm": "centimetres",
               "mm": "millimetres"}  # fmt: skip


@dataclass(frozen=True)
class Conclusions:
    """Unit and frames of the arrays of one dataset."""

    metres: float
    """Length of the release's unit, metres."""
    is_canonical: bool
    """True if nearly all motions are canonical already."""
    goal_frame: str
    """One of the survey's frames, or ``unknown``."""
    inferences: tuple[Inference, ...]
    warnings: tuple[str, ...]


def conclude(where: str, measured: Sequence[Measured], *, stated_unit: str | None = None) -> Conclusions:
    """Judge the measurements of all sequences of one dataset.

    Args:
        where: Folder of the dataset, for messages.
        measured: Measurements of all sequences.
        stated_unit: Unit that the release states, if any.

    Raises:
        InputFileError: if the motions are too small or too large for people in metres, centimetres or millimetres, or
            in the stated unit.
    """
    metres, unit = _unit(where, measured, stated_unit)
    is_canonical, canonical = _canonical(measured, metres)
    goal_frame, goal = _goal_frame(measured, metres)
    gaze, warnings = _gaze(measured, metres, goal_frame)
    inferences = (unit, canonical, goal, _skeleton(measured, metres), gaze)
    return Conclusions(metres, is_canonical, goal_frame, inferences, warnings)


def _unit(where: str, measured: Sequence[Measured], stated: str | None) -> tuple[float, Inference]:
    bounds = load_known().pelvis_to_head
    # Bodies differ by some per cent, units by factors of ten: the distance from pelvis to head tells them apart.
    median = float(np.median([each.pelvis_to_head for each in measured]))
    word = (stated or "").strip().lower()
    said = _UNIT_NAMES.get(word, word)
    evidence = f"median distance from pelvis to head: {median:.3g}"
    for name, metres in _UNITS.items():
        if not bounds.lowest <= median * metres <= bounds.highest or (said in _UNITS and said != name):
            continue
        if said == name:
            return metres, Inference("units", name, "certain", f"stated as '{stated}'; {evidence}")
        return metres, Inference("units", name, "likely" if metres == 1.0 else "assumed", evidence)
    unit = f"in {said} as stated" if said in _UNITS else "or the same in centimetres or millimetres"
    raise InputFileError(
        where,
        "motions",
        expected=f"a median distance from pelvis to head of {bounds.lowest:g} to {bounds.highest:g} m ({unit})",
        found=f"{median:.3g}",
        remedy="Check units and joint order: 22 joints in the order of HumanML3D, y up.",
    )


def _canonical(measured: Sequence[Measured], metres: float) -> tuple[bool, Inference]:
    share = float(np.mean([is_canonical_already(each, metres) for each in measured]))
    evidence = f"frame 0 stands over the origin, faces +z, lowest joint at 0 in {share:.1%} of the sequences"
    if share >= load_known().canonical.agreeing:
        return True, Inference("motion_frame", "canonical", "certain" if share == 1 else "likely", evidence)
    certainty = "certain" if share < 0.05 else "likely"
    return False, Inference("motion_frame", "world (canonicalised here)", certainty, evidence)


def is_canonical_already(measured: Measured, metres: float) -> bool:
    """Return True where a motion is given in its own canonical frame."""
    rules = load_known().canonical
    world_from_canonical = measured.world_from_canonical
    # The matrix is a turn about y and a shift, so two entries hold the whole angle.
    yaw = np.degrees(np.arctan2(world_from_canonical[0, 2], world_from_canonical[0, 0]))
    offset = np.abs(world_from_canonical[:3, 3]).max() * metres
    return bool(offset <= rules.position and abs(yaw) <= rules.yaw_deg)


def _goal_frame(measured: Sequence[Measured], metres: float) -> tuple[str, Inference]:
    limit = load_known().goal.wrist_distance
    medians = np.median([each.goal_to_wrist for each in measured], axis=0) * metres
    tried = ", ".join(f"{name} {median:.2f} m" for name, median in zip(GOAL_FRAMES, medians))
    evidence = f"median distance of goal and nearer wrist in the last frame: {tried}"
    # The frame of the motions is the plain reading; another one has to be needed, not only slightly nearer.
    best = 0 if medians[0] < limit else int(medians.argmin())
    if medians[best] >= limit:
        return UNKNOWN, Inference("goal_frame", UNKNOWN, "unknown", f"{evidence}; none below {limit:g} m")
    return GOAL_FRAMES[best], Inference("goal_frame", GOAL_FRAMES[best], "likely", evidence)


def _skeleton(measured: Sequence[Measured], metres: float) -> Inference:
    """Tell one skeleton that all sequences share from people's own bones."""
    spread = float(mean_bones(measured).std(axis=0).max()) * metres
    change = float(np.median([each.bone_change for each in measured])) * metres
    evidence = (
        f"largest standard deviation of a bone: {spread * 1000:.2f} mm over the sequences,"
        f" {change * 1000:.2f} mm within one (median)"
    )
    # One sequence has no spread over sequences.
    if len(measured) < 2:
        return Inference("skeleton", UNKNOWN, "unknown", "a single sequence cannot tell")
    uniform = spread <= load_known().skeleton.uniform
    return Inference("skeleton", "uniform" if uniform else "people's own bones", "likely", evidence)


def _gaze(measured: Sequence[Measured], metres: float, goal_frame: str) -> tuple[Inference, tuple[str, ...]]:
    """Count how often the gaze passes the goal at the primed frame, which checks frame, base and rate together."""
    rules = load_known().goal
    rays = [each.gaze_ray for each in measured if each.gaze_ray is not None]
    if not rays:
        return Inference("gaze_on_goal", UNKNOWN, "unknown", "no valid gaze at any primed frame"), (
            "No sequence has a valid gaze at its primed frame.",
        )
    shares = (np.array(rays) * metres <= rules.gaze_distance).mean(axis=0)
    place = 0 if goal_frame == UNKNOWN else GOAL_FRAMES.index(goal_frame)
    share = float(shares[place])
    evidence = f"gaze ray from the head joint within {rules.gaze_distance:g} m of the goal at the primed frame"
    counted = f"{share:.1%} of {len(rays)} sequences"
    if share >= rules.gaze_share:
        return Inference("gaze_on_goal", counted, "likely", evidence), ()
    warning = (
        f"The gaze meets the goal at the primed frame in {share:.0%} of the sequences only (expected: a clear"
        " majority). Frame, base of the primed frames, or rate is probably wrong."
    )
    return Inference("gaze_on_goal", counted, "unknown", evidence), (warning,)
