"""While tests run, functions and data classes refuse arrays of another shape than they are annotated with."""

from __future__ import annotations

import os

import jaxtyping
import numpy as np
import pytest

from prbench.files.arrays import first_repeated, require_times
from prbench.geometry.skeleton import y_up
from prbench.metrics.batch import GazeRays, MotionBatch
from prbench.metrics.foot_skating import Fps
from tests import shapes

pytestmark = pytest.mark.skipif(os.environ.get("PRBENCH_CHECK_SHAPES", "1") != "1", reason="shapes are not checked")


def test_arrays_of_another_shape_are_refused_by_functions_and_data_classes() -> None:
    assert y_up(np.zeros((5, 3))).shape == (5, 3)
    with pytest.raises(jaxtyping.TypeCheckError):
        y_up(np.zeros((5, 4)))
    with pytest.raises(jaxtyping.TypeCheckError):
        require_times("gaze", np.zeros((2, 2)))
    with pytest.raises(jaxtyping.TypeCheckError):
        GazeRays(np.zeros((5, 3)), np.zeros((5, 3)), np.zeros(5))  # not Booleans


def test_checks_can_be_switched_off_for_calls_without_end() -> None:
    with shapes.unchecked():
        assert y_up(np.zeros((5, 4))).shape[0] == 5


def test_a_name_for_a_type_with_an_array_in_it_counts_and_what_names_none_is_left_alone() -> None:
    def of_rates(fps: Fps) -> None:
        assert fps

    of_rates.__annotations__ = {"fps": "Fps | None", "return": "None"}
    assert shapes._names_arrays(of_rates)
    assert shapes._names_arrays(MotionBatch)
    assert shapes._names_arrays(MotionBatch.from_motions)
    assert not shapes._names_arrays(first_repeated)
    assert not shapes._names_arrays(str)
