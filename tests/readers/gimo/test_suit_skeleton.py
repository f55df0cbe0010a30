"""A suit's skeleton laid along the fitted pelvis: names, units and time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.readers.gimo.bvh import BvhMotion, place_skeleton
from tests.fakes import STANDING
from tests.readers.gimo_sample import LEAD, N_FRAMES, path_of_pelvis, skeleton

SECONDS = 7.0 + np.arange(N_FRAMES) / 30


def laid(motion: BvhMotion, pelvis: np.ndarray | None = None):
    track = path_of_pelvis(SECONDS - 7.0) if pelvis is None else pelvis
    return place_skeleton(motion, SECONDS, track, name="skeleton.bvh", largest_error=0.05)


@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0])
def test_time_and_unit_are_found(unit) -> None:
    joints, remarks = laid(skeleton(unit=unit))
    assert LEAD / 60 == 0.5
    assert remarks == [
        "limbs from skeleton.bvh, which begins 0.500 s before the segment and follows the fitted pelvis within 0 mm"
    ]
    expected = STANDING - STANDING[0] + path_of_pelvis(SECONDS - 7.0)[:, None]
    np.testing.assert_allclose(joints, expected, atol=1e-5)


def test_an_offset_of_the_hips_is_taken_away() -> None:
    shifted = skeleton()
    shifted.values[:, :3] += (30.0, -20.0, 5.0)  # centimetres
    np.testing.assert_allclose(laid(shifted)[0], laid(skeleton())[0], atol=1e-4)


def test_another_walk_is_refused() -> None:
    backwards = replace(skeleton(), values=skeleton().values[::-1].copy())
    with pytest.raises(InputFileError, match="expected hips within 5 cm of the fitted pelvis"):
        laid(backwards)


def test_a_short_file_is_refused() -> None:
    short = replace(skeleton(), values=skeleton().values[:60])
    with pytest.raises(InputFileError, match=r"at least the 1\.47 s of the segment, found 0\.98 s"):
        laid(short)


def test_legs_of_no_human_length_are_refused() -> None:
    with pytest.raises(InputFileError, match=r"expected legs of 0\.5 to 1\.2 m"):
        laid(skeleton(unit=7.0))


def test_who_stands_still_is_aligned_by_guess() -> None:
    standing = replace(skeleton(), values=np.tile(skeleton().values[0], (200, 1)))
    _, remarks = laid(standing, np.tile(path_of_pelvis(np.zeros(1)), (N_FRAMES, 1)))
    assert remarks[-1] == "the pelvis hardly moves, so the skeleton's start is a guess"
