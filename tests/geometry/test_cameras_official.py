"""Camera models beside those of the official tools."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.cameras import MODELS, fisheye624

PARAMETERS = {
    "FISHEYE624": [610.0, 714.0, 705.0, 0.41, -0.47, 0.04, 1.3, -1.7, 0.65, 8e-5, 6e-4, -1e-3, 6e-4, -2e-3, 1.7e-3],
    "LINEAR": [600.0, 610.0, 700.0, 710.0],
}


@pytest.mark.parametrize("name", MODELS)
def test_official_models_project_to_the_same_pixels(name):
    calibration = pytest.importorskip("projectaria_tools.core.calibration", reason="the official reader is missing")
    official = calibration.CameraProjection(getattr(calibration.CameraModelType, name), np.array(PARAMETERS[name]))
    points = np.random.default_rng(0).normal(size=(50, 3)) * [0.8, 0.8, 1.0] + [0.0, 0.0, 4.0]
    expected = [official.project(point) for point in points]
    np.testing.assert_allclose(MODELS[name][1](points, np.array(PARAMETERS[name])), expected, atol=1e-8)


def test_without_distortion_the_distance_from_the_centre_is_the_angle():
    parameters = np.array([600.0, 700.0, 710.0, *[0.0] * 12])
    found = fisheye624(np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 1.0]]), parameters)
    np.testing.assert_allclose(found, [[700.0, 710.0], [700.0 + 600.0 * np.pi / 4, 710.0]])
