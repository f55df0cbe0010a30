"""Small scenes for the tests of views."""

from __future__ import annotations

import msgspec
import numpy as np

from prbench.metrics import GazeRays
from prbench.protocol.manifests import load_protocol
from prbench.viewing.replay.scene import METHOD_COLOURS, RECORDED, RECORDED_COLOUR, Goal, Scene, ShownMotion
from tests.fakes import STANDING

N_FRAMES = 61
PRIME = 2.0
_CORNERS = np.array([(x, y, z) for x in (-0.05, 0.05) for y in (-0.05, 0.05) for z in (-0.05, 0.05)])


def walking(n_frames: int = N_FRAMES, *, sideways: float = 0.0) -> np.ndarray:
    """The standing body sliding 1.5 m along +Z."""
    offset = np.zeros((n_frames, 1, 3))
    offset[:, 0, 2] = np.linspace(0.0, 1.5, n_frames)
    offset[:, 0, 0] = sideways
    return STANDING + offset


def a_scene(
    *labels: str,
    n_frames: int = N_FRAMES,
    fps: float = 20.0,
    recorded: bool = True,
    notice: str = "",
    with_eyes: bool = False,
) -> Scene:
    """A recorded walk to a goal 2 m ahead, with a method's motion for every label, which may have gaze as well."""
    scores = {"prime_success": 1.0, "reach_success": 0.0, "goal_mpjpe": 0.123, "location_error": 1.0, "mpjpe": 1.5}
    valid = np.ones(n_frames, dtype=bool)
    ahead = np.tile([0.0, 0.0, 1.0], (n_frames, 1))
    eyes = GazeRays(walking(n_frames, sideways=0.2)[:, 15], ahead, valid) if with_eyes else None
    motions = [
        ShownMotion(label, colour, walking(n_frames, sideways=0.2 * (number + 1)), scores, eyes)
        for number, (label, colour) in enumerate(zip(labels, METHOD_COLOURS, strict=False))
    ]
    seen = valid.copy()
    seen[3:4] = False  # a gap, where there are that many frames
    gaze = GazeRays(walking(n_frames)[:, 15], ahead, seen)
    own = ShownMotion(RECORDED, RECORDED_COLOUR, walking(n_frames), {"prime_success": 0.0, "reach_success": 1.0}, gaze)
    location = np.array([0.1, 1.0, 2.0])
    return Scene(
        sequence_id="made-up/recording_with_a_long_name_000/4508463855879675/pick/50.000000/fake-body-source",
        dataset="made-up",
        title="pick of WoodenBowl, right hand (test)",
        action="pick",
        fps=fps,
        n_frames=n_frames,
        prime_time=PRIME,
        head_tilt_deg=7.4,
        motions=(own, *motions) if recorded else tuple(motions),
        thresholds=msgspec.structs.replace(
            load_protocol().metrics, prime_distance=0.25, prime_window=1.0, reach_distance=0.10
        ),
        goal=Goal(location, location + _CORNERS) if recorded else None,
        notice=notice,
    )
