"""Scores of one sequence in words."""

from __future__ import annotations

from prbench.viewing.replay.measures import measure
from prbench.viewing.replay.scene import Scene, ShownMotion

HEADER = ("", "Prime\nSuccess", "Reach\nSuccess", "nearest\nwrist", "Location\nError", "Goal\nMPJPE", "MPJPE")
"""Of the table of scores; "nearest wrist" is the smallest distance between a wrist and the goal."""


def score_row(scene: Scene, motion: ShownMotion) -> tuple[str, ...]:
    """One row of the table, in the order of :data:`HEADER`; an en dash where nothing is known."""
    scores = motion.scores
    wrist = None if scene.goal is None else measure(motion, scene.goal, scene.head_tilt_deg).reach_distance
    recorded = motion is scene.motions[0] and scene.shows_recorded
    return (
        motion.label,
        _yes_no(scores.get("prime_success")),
        _yes_no(scores.get("reach_success")),
        _length(wrist),
        "–" if recorded else _yes_no(scores.get("location_error")),
        "–" if recorded else _length(scores.get("goal_mpjpe")),
        "–" if recorded else _length(scores.get("mpjpe")),
    )


def score_sentence(scene: Scene, motion: ShownMotion) -> str:
    """The same in one line."""
    names = (name.replace("\n", " ") for name in HEADER[1:])
    values = score_row(scene, motion)[1:]
    return ", ".join(f"{name} {value}" for name, value in zip(names, values, strict=True) if value != "–")


def verdict(scene: Scene, motion: ShownMotion) -> str:
    """The two main scores in a few words."""
    _, primed, reached, wrist, *_ = score_row(scene, motion)
    if primed == "–":
        return "not scored"
    return f"Prime Success {primed}, Reach Success {reached} ({wrist})"


def phase(scene: Scene, frame: int) -> str:
    """What happens at a frame, where something does: shown for a quarter of a second."""
    if frame == scene.n_frames - 1:
        return f"{scene.action}  "
    since = frame / scene.fps - scene.prime_time
    return "prime  " if abs(since) <= 0.125 else ""


def _yes_no(rate: float | None) -> str:
    return "–" if rate is None else "yes" if rate >= 0.5 else "no"


def _length(metres: float | None) -> str:
    return "–" if metres is None else f"{metres * 100:.0f} cm" if metres < 0.995 else f"{metres:.2f} m"
