"""Stick figures stand in the picture where their joints are."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.viewing.figures import flattened


def test_figures_keep_their_height_and_show_what_lies_in_the_picture_plane() -> None:
    points = np.array([[1.0, 1.7, 2.0], [1.0, 0.0, 2.5]])
    flat = flattened(points, np.array([1.0, 0.9, 2.0]), np.array([0.0, 0.0, 1.0]), 3.0)
    assert flat == pytest.approx(np.array([[3.0, 1.7], [3.5, 0.0]]))
