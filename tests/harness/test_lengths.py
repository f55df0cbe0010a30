"""Motions of another length: the first one is named, and the cause that explains all of them."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.harness.methods.motions import native_frames
from prbench.harness.recorded_motion import length_problem, likely_cause

EXPECTED = np.array([81, 60, 120, 97])


def cause(found):
    return likely_cause(EXPECTED, np.asarray(found), fps=20.0)


@pytest.mark.parametrize("rate", [10.0, 12.5, 15.0, 24.0, 25.0, 30.0, 50.0, 60.0, 100.0, 120.0])
def test_lengths_of_another_usual_rate_are_recognised(rate):
    for round_off in (-1, 0):
        found = native_frames(EXPECTED, fps=20.0, native_fps=rate) + round_off
        assert f"motions at {rate:g} frames per second where 20 are asked for" in cause(found)
        assert f"--native-fps {rate:g}" in cause(found)


def test_motions_at_the_table_rate_where_another_was_asked_for_are_recognised():
    native = native_frames(EXPECTED, fps=20.0, native_fps=30.0)
    assert "motions at 20 frames per second where 30 are asked for" in likely_cause(native, EXPECTED, fps=30.0)


def test_one_frame_more_or_less_is_explained():
    assert "previous_joints" in cause(EXPECTED + 1)
    assert "initial one" in cause(EXPECTED - 1)
    assert "one frame too many" in cause(EXPECTED + np.array([0, 1, 0, 0]))


def test_padded_and_cut_motions_are_explained():
    assert "All have 196 frames, as padded motions do" in cause([196] * 4)
    assert "--max-frames 90" in cause([81, 60, 90, 90])


def test_what_fits_no_cause_is_not_explained():
    assert cause(EXPECTED + np.array([0, 7, 0, -3])) == ""
    assert likely_cause(np.array([100]), np.array([75]), fps=20.0) == "", "a single motion says nothing about a rate"


def test_the_first_motion_and_the_number_of_others_are_named():
    problem = length_problem("row {}".format, EXPECTED, EXPECTED + np.array([0, 5, 5, 0]), fps=20.0)
    assert problem == "row 1: expected 60 frames, found 65 (and 1 other motions of 4)."
    assert length_problem("row {}".format, EXPECTED, EXPECTED, fps=20.0) is None
