"""Camera models: from points before a camera to pixels of its image."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

Parameters = Float[np.ndarray, " parameters"]
Points = Float[np.ndarray, "n 3"]
Pixels = Float[np.ndarray, "n 2"]


def fisheye624(points: Points, parameters: Parameters) -> Pixels:
    """Project through Aria's camera model: six radial, two tangential and four thin-prism numbers.

    Source: Project Aria Docs, "Camera intrinsic models".

    Args:
        points: Before the camera, whose z points forward, metres; z > 0.
        parameters: f, cx, cy, k0 to k5, p0, p1, s0 to s3; the first three in pixels.

    Returns:
        (x, y) of the sensor's image, whose first pixel has its centre at (0, 0).
    """
    focal, centre, radial, tangential, prism = np.split(parameters, [1, 3, 9, 11])
    plane = points[:, :2] / points[:, 2:]
    radius = np.linalg.norm(plane, axis=1, keepdims=True)
    angle = np.arctan(radius)
    bent = angle * (1 + (radial * angle ** np.arange(2, 13, 2)).sum(axis=1, keepdims=True))
    place = plane * np.where(radius > 0, bent / np.where(radius > 0, radius, 1.0), 1.0)
    square = (place**2).sum(axis=1, keepdims=True)
    shifted = place + 2 * (place * tangential).sum(axis=1, keepdims=True) * place + square * tangential
    shifted += prism[[0, 2]] * square + prism[[1, 3]] * square**2
    return focal * shifted + centre


def pinhole(points: Points, parameters: Parameters) -> Pixels:
    """Project without distortion; see :func:`fisheye624`.

    Args:
        points: Before the camera, metres; z > 0.
        parameters: fx, fy, cx, cy, pixels.
    """
    return points[:, :2] / points[:, 2:] * parameters[:2] + parameters[2:]


# Maps the name of a model in a calibration file to its number of parameters and its function.
MODELS: Mapping[str, tuple[int, Callable[[Points, Parameters], Pixels]]] = {
    "FISHEYE624": (15, fisheye624),
    "LINEAR": (4, pinhole),
}
