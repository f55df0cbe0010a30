"""Stick figures seen from the side: right limbs red, left limbs blue."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.skeleton import CHAINS, Joint, head_forward

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = ("tab:red", "tab:blue", "0.25", "tab:red", "tab:blue")
"""In the order of the chains: right leg, left leg, trunk, right arm, left arm."""
_HEAD_LINE = 0.35  # metres


def draw_figure(
    axes: Axes,
    joints: Float[np.ndarray, "22 3"],
    head_tilt_deg: float,
    sideways: Float[np.ndarray, "3"],
    at: float,
    *,
    finger_bases: Float[np.ndarray, "2 3"] | None = None,
) -> None:
    """Draw one pose in a vertical plane, and the head-forward vector as a short line.

    Args:
        axes: Where; x is the horizontal of the picture, y the height, both in metres.
        joints: World frame.
        head_tilt_deg: See :func:`prbench.skeleton.head_forward`.
        sideways: Unit horizontal vector that points to the right in the picture.
        at: Where in the picture the pelvis stands.
        finger_bases: Ends of the hands, left and right.
    """
    flat = flattened(joints, joints[Joint.PELVIS], sideways, at)
    for chain, colour in zip(CHAINS, _COLOURS, strict=True):
        axes.plot(flat[list(chain), 0], flat[list(chain), 1], color=colour, linewidth=1.1, solid_capstyle="round")
    if finger_bases is not None:
        ends = flattened(finger_bases, joints[Joint.PELVIS], sideways, at)
        for end, wrist, colour in zip(
            ends, (Joint.LEFT_WRIST, Joint.RIGHT_WRIST), ("tab:blue", "tab:red"), strict=True
        ):
            axes.plot([flat[wrist, 0], end[0]], [flat[wrist, 1], end[1]], color=colour, linewidth=1.8)
    forward, _ = head_forward(joints, head_tilt_deg)
    tip = flattened((joints[Joint.HEAD] + _HEAD_LINE * forward)[None], joints[Joint.PELVIS], sideways, at)[0]
    axes.plot(*zip(flat[Joint.HEAD], tip, strict=True), color="tab:green", linewidth=0.8)
    axes.plot(*flat[Joint.HEAD], "o", color="0.25", markersize=3.0)


def flattened(
    points: Float[np.ndarray, "n 3"], pelvis: Float[np.ndarray, "3"], sideways: Float[np.ndarray, "3"], at: float
) -> Float[np.ndarray, "n 2"]:
    """Picture coordinates of points around a pelvis."""
    return np.stack([(points - pelvis) @ sideways + at, points[:, 1]], axis=-1)
