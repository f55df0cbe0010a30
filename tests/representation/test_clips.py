"""Clips before they are encoded: canonical frame and 20 frames a second."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.errors import InputFileError
from prbench.representation import at_20_fps, canonicalise, every_stride
from prbench.skeleton import facing_yaw
from tests.fakes import smooth_motion
from tests.representation.motions import turned


def test_the_canonical_frame_is_that_of_the_tables():
    joints = (turned(smooth_motion("clip", 30), 2.2) + np.array([3.0, -0.4, 1.0])).astype(np.float32)
    canonical = canonicalise(joints)
    assert canonical.dtype == np.float32
    assert np.allclose(canonical[0, 0, ::2], 0.0, atol=1e-6)
    assert facing_yaw(canonical[0]) == pytest.approx(0.0, abs=1e-6)
    assert canonical[..., 1].min() == pytest.approx(0.0, abs=1e-6)
    assert np.allclose(canonicalise(canonical), canonical, atol=1e-6)


def ramp(n_frames: int, fps: float) -> np.ndarray:
    """Joints whose x is the time in seconds."""
    joints = np.repeat(smooth_motion("ramp", 1), n_frames, axis=0)
    joints[:, :, 0] = (np.arange(n_frames) / fps)[:, None]
    return joints


@pytest.mark.parametrize("fps", [20.0, 30.0, 59.94, 120.0, 12.5])
def test_twenty_frames_a_second_end_on_the_last_frame(fps):
    joints = ramp(100, fps)
    resampled = at_20_fps(joints, fps)
    assert np.array_equal(resampled[-1], joints[-1])
    assert np.allclose(np.diff(resampled[:, 0, 0]), 0.05, atol=1e-6)
    assert 0.0 <= resampled[0, 0, 0] < 0.05


def test_twenty_frames_a_second_stay_as_they_are():
    joints = smooth_motion("same", 40)
    assert np.allclose(at_20_fps(joints, 20.0), joints, atol=1e-6)


@pytest.mark.parametrize(
    ("fps", "stride", "left"), [(120.0, 6, 20.0), (100.0, 5, 20.0), (60.0, 3, 20.0), (59.0, 2, 29.5), (30.0, 1, 30.0)]
)
def test_the_stride_of_the_original_keeps_its_wrong_rates(fps, stride, left):
    joints = ramp(61, fps)
    kept, rate = every_stride(joints, fps)
    assert rate == left
    assert np.array_equal(kept, joints[::stride])


def test_rates_without_meaning_are_refused():
    with pytest.raises(InputFileError, match=r"clip\.npy: expected 20 frames a second or more, found 12\.5"):
        every_stride(ramp(10, 12.5), 12.5, source="clip.npy")
    for rate in (0.0, -30.0, float("nan")):
        with pytest.raises(InputFileError, match="a frame rate above 0"):
            at_20_fps(ramp(10, 30.0), rate)
