"""Bodies in pictures: limbs as thick as a person's, the nearer ones over the farther ones, left limbs lighter."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import BONES, Joint, head_forward

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection

Vector = Float[np.ndarray, "3"]
Flatten = Callable[[np.ndarray], np.ndarray]  # maps points (..., 3) to a picture's coordinates

# Metres; each bone has the thickness of the joint at its end.
_TRUNK = {"HIP": 0.17, "SPINE1": 0.26, "SPINE2": 0.25, "SPINE3": 0.27, "NECK": 0.12, "HEAD": 0.11, "COLLAR": 0.19}
_LIMBS = {"KNEE": 0.15, "ANKLE": 0.10, "FOOT": 0.08, "SHOULDER": 0.13, "ELBOW": 0.09, "WRIST": 0.075}
_HAND = 0.09  # metres from the wrist to the middle of the hand
_SKULL = (0.02, 0.09, 0.17)  # metres before and above the head joint, and across
_NOSE = (0.115, 0.075, 0.035)
_OUTLINE = 0.7  # points of white around each part of a limb
_LIGHTER = 0.45  # share of white in left limbs


def body_parts(
    joints: Float[np.ndarray, "poses 22 3"], head_tilt_deg: float
) -> tuple[Float[np.ndarray, "poses parts 2 3"], Float[np.ndarray, " parts"], np.ndarray]:
    """Return both ends of every part of some bodies, the thickness of each part, and True for parts of the left.

    Args:
        joints: Any frame with Y up, metres.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
    """
    names = [Joint(child).name.removeprefix("LEFT_").removeprefix("RIGHT_") for _, child in BONES]
    ends = list(np.moveaxis(joints[:, np.array(BONES)], 1, 0))
    thickness = [_TRUNK.get(name) or _LIMBS[name] for name in names]
    left = [name in _LIMBS and Joint(child).name.startswith("LEFT") for name, (_, child) in zip(names, BONES)]
    for side in ("LEFT", "RIGHT"):
        wrist = joints[:, Joint[f"{side}_WRIST"]]
        forearm = wrist - joints[:, Joint[f"{side}_ELBOW"]]
        forearm = forearm / np.maximum(np.linalg.norm(forearm, axis=-1, keepdims=True), 1e-9)
        ends.append(np.stack([wrist, wrist + _HAND * forearm], axis=1))
        thickness.append(_LIMBS["WRIST"])
        left.append(side == "LEFT")
    forward, _ = head_forward(joints, head_tilt_deg)
    head = joints[:, Joint.HEAD]
    up = head - joints[:, Joint.NECK]
    up = up - (up * forward).sum(axis=-1, keepdims=True) * forward
    up = up / np.maximum(np.linalg.norm(up, axis=-1, keepdims=True), 1e-9)
    middle = head + _SKULL[0] * forward
    ends.append(np.stack([middle + 0.03 * up, middle + _SKULL[1] * up], axis=1))
    nose = head + _NOSE[1] * up
    ends.append(np.stack([nose + 0.06 * forward, nose + _NOSE[0] * forward], axis=1))
    return np.stack(ends, axis=1), np.array([*thickness, _SKULL[2], _NOSE[2]]), np.array([*left, False, False])


def body_lines(
    axes: Axes,
    joints: Float[np.ndarray, "poses 22 3"],
    colour: str,
    flat: Flatten,
    towards: Vector,
    *,
    head_tilt_deg: float,
) -> dict[str, Any]:
    """Return what :func:`draw_bodies` draws as properties of a ``LineCollection``, by which a film moves it.

    Args:
        axes: Panel with its final place and limits, by which thickness is told in points.
        joints: Canonical frame, metres; a pose is drawn over those before it.
        colour: ``#rrggbb``.
        flat: Maps points (poses, n, 3) to the panel's coordinates (poses, n, 2), metres.
        towards: Unit vector that points to whoever looks at the picture.
        head_tilt_deg: See :func:`prbench.geometry.skeleton.head_forward`.
    """
    from matplotlib.colors import to_rgb

    parts, thickness, left = body_parts(joints, head_tilt_deg)
    axes.apply_aspect()
    (_, low), (_, high) = axes.transData.transform([(0.0, 0.0), (0.0, 1.0)])
    widths = thickness * (high - low) * 72 / axes.figure.dpi
    full = np.array(to_rgb(colour))
    colours = np.where(left[:, None], full + _LIGHTER * (1 - full), full)
    shown = flat(parts.reshape(len(parts), -1, 3)).reshape(*parts.shape[:3], 2)
    # Farther parts come first; limbs have a white outline, by which they are told from what is behind them.
    outline = np.array([0.0 if width in _TRUNK.values() else 2 * _OUTLINE for width in thickness])
    order = np.argsort((parts.mean(axis=2) @ towards), axis=1, kind="stable")
    segments = np.take_along_axis(shown, order[:, :, None, None], axis=1).reshape(-1, 2, 2)
    order = order.ravel()
    outlined = np.stack([widths[order] + outline[order], widths[order]], axis=1).ravel()
    edges = np.where(outline[order, None] > 0, 1.0, colours[order])
    shades = np.stack([edges, colours[order]], axis=1).reshape(-1, 3)
    return {"segments": list(segments.repeat(2, axis=0)), "linewidths": outlined, "color": shades}


def draw_bodies(
    axes: Axes,
    joints: Float[np.ndarray, "poses 22 3"],
    colour: str,
    flat: Flatten,
    towards: Vector,
    *,
    head_tilt_deg: float,
    zorder: float = 3.0,
) -> LineCollection:
    """Draw bodies into a panel; see :func:`body_lines`."""
    from matplotlib.collections import LineCollection

    drawn = body_lines(axes, joints, colour, flat, towards, head_tilt_deg=head_tilt_deg)
    lines = LineCollection(**drawn, capstyle="round", zorder=zorder)
    axes.add_collection(lines, autolim=False)
    return lines
