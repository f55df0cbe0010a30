"""Features with an absolute root, the projection, and the U-Nets."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench.representation import encode, tensors
from prbench_adapters.gmd.model import (
    HEADING,
    GMDConfiguration,
    GMDNetworks,
    decode_absolute,
    emphasis_projection,
    half_turn_of,
    pose_columns,
    with_absolute_root,
)
from tests.adapters.gmd import tiny
from tests.fakes import STANDING, smooth_motion


def _walk(frames: int) -> torch.Tensor:
    """On a curve: the body turns by 117 degrees and ends 2 m away; canonical in frame 0."""
    joints = np.broadcast_to(STANDING, (frames, 22, 3)).copy()
    angle = np.linspace(0, 2.04, frames)[:, None]
    x, z = joints[..., 0].copy(), joints[..., 2].copy()
    joints[..., 0] = np.cos(angle) * x + np.sin(angle) * z + 1.2 * np.sin(angle)
    joints[..., 2] = np.cos(angle) * z - np.sin(angle) * x + 1.2 * (1 - np.cos(angle))
    return torch.from_numpy(joints)[None]


def _encoded(motion: torch.Tensor) -> torch.Tensor:
    """Features of one motion, float32 numbers; its last frame stays where it is."""
    joints = motion[0].numpy()
    return torch.from_numpy(encode(joints, next_joints=joints[-1]).astype(np.float64))[None]


@pytest.fixture(scope="module")
def walk() -> torch.Tensor:
    return _walk(40)


@pytest.fixture(scope="module")
def features(walk) -> torch.Tensor:
    return _encoded(walk)


def test_the_heading_is_half_the_turn():
    """In the middle, where smoothing over 80 frames on each side changes nothing about an even turn."""
    heading = with_absolute_root(_encoded(_walk(200)))[0, :, HEADING][:, 0]
    steps = torch.full((19,), 2.04 / 199 / 2, dtype=torch.float64)
    assert torch.allclose(heading[90:110].diff().abs(), steps, rtol=1e-6)
    assert float(heading[0]) == 0.0


def test_absolute_features_decode_to_the_same_joints(walk, features):
    assert torch.allclose(decode_absolute(with_absolute_root(features)), walk, atol=1e-9)
    assert torch.allclose(tensors.decode(features), walk, atol=1e-9)


def test_the_error_of_one_row_stays_in_that_row(features):
    """What relative features lack: a wrong step there displaces all later frames."""
    absolute = with_absolute_root(features)
    wrong = absolute.clone()
    wrong[:, 7, :4] += 0.2
    moved = (decode_absolute(wrong) - decode_absolute(absolute)).abs().amax(dim=(0, 2, 3))
    assert moved[7] > 0.1
    assert moved.sum() == moved[7]


def test_padding_of_absolute_features_leaves_no_trace(features):
    padded = torch.nn.functional.pad(features, (0, 0, 0, 5), value=torch.nan)
    assert torch.equal(with_absolute_root(padded)[:, :40], with_absolute_root(features))


@pytest.mark.parametrize("half_turn", [0.0, 0.7, -1.5])
def test_a_pose_has_columns_that_lead_back_to_it_for_any_heading(half_turn):
    pose = torch.as_tensor(smooth_motion("pose", 2)[:1]).double()
    columns = pose_columns(pose, torch.tensor([half_turn], dtype=torch.float64))
    assert torch.allclose(decode_absolute(columns[:, None])[:, 0], pose, atol=1e-12)
    assert float(columns[0, 0]) == half_turn


@pytest.mark.parametrize("angle", [0.0, 0.5, -1.2, 3.0])
def test_the_heading_of_a_pose_is_the_one_that_a_motion_of_it_has(angle):
    """A body that stands turned all the time: the representation's own heading, once frame 0 is left behind."""
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    pose = torch.from_numpy(STANDING @ turn.T)
    features = _encoded(pose.expand(1, 4, 22, 3))
    expected = with_absolute_root(features)[0, -1, 0]
    assert float(half_turn_of(pose[None])[0]) == pytest.approx(float(expected), abs=1e-6)


def test_the_projection_emphasises_the_absolute_root_as_published():
    """docs/specification/gmd.md#emphasis-projection: row norms of 10·√263/√560 = 6.853 and 0.685 are expected."""
    norms = emphasis_projection(10.0).norm(dim=1)
    assert float(norms[:3].mean()) == pytest.approx(6.853, rel=0.1)
    assert float(norms[3:].mean()) == pytest.approx(0.685, rel=0.01)


def test_the_projection_is_the_same_every_time_and_survives_half_precision():
    projection = emphasis_projection(10.0)
    assert torch.equal(projection, emphasis_projection(10.0))
    assert torch.equal(projection, projection.half().float())
    assert float(torch.linalg.cond(projection.double())) < 1500


def test_projection_and_statistics_are_undone(features):
    space = tiny.space()
    raw = with_absolute_root(features).float()
    projected = space.projected(space.standardised(raw))
    assert torch.allclose(space.restored(space.unprojected(projected)), raw, atol=1e-4)
    assert not torch.allclose(projected, space.standardised(raw), atol=0.5)
    root = space.standardised(raw[..., :4])  # what the trajectory network sees
    assert torch.equal(root, space.standardised(raw)[..., :4])
    assert torch.allclose(space.restored(root), raw[..., :4], atol=1e-6)


def _inputs(frames: int = 12, batch: int = 2) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(3)
    noisy = torch.randn(batch, frames, 263, generator=generator)
    return noisy, torch.arange(batch), torch.randn(batch, 64, generator=generator)


def test_what_stands_behind_the_last_frame_leaves_no_trace():
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    n_frames = torch.tensor([12, 7])
    expected = network(noisy, step, text, n_frames, window=16)
    noisy[1, 7:] = 1e3
    found = network(noisy, step, text, n_frames, window=16)
    assert torch.equal(found[0], expected[0])
    assert torch.equal(found[1, :7], expected[1, :7])


def test_a_row_does_not_depend_on_how_long_its_mates_are():
    network, (noisy, step, text) = tiny.networks().motion, _inputs()
    together = network(noisy, step, text, torch.tensor([12, 7]), window=16)
    alone = network(noisy[1:, :7], step[1:], text[1:], torch.tensor([7]), window=16)
    assert torch.allclose(alone[0], together[1, :7], atol=1e-5)


def test_before_training_blocks_pass_their_input_on():
    """Conditions and second convolutions start at zero: then text and step cannot reach the output."""
    torch.manual_seed(0)
    network, (noisy, step, text) = GMDNetworks(tiny.configuration()).motion, _inputs()
    n_frames = torch.tensor([12, 12])
    outputs = [network(noisy, step, words, n_frames, window=16) for words in (text, -text)]
    assert torch.equal(*outputs)


@pytest.mark.parametrize(
    ("n_frames", "padded", "step", "window"),
    [(40, 224, 8, 224), (224, 224, 8, 224), (225, 224, 8, 232), (241, 224, 8, 248), (65, 64, 32, 96)],
)
def test_motions_are_padded_to_one_length_and_longer_ones_as_little_as_possible(n_frames, padded, step, window):
    configuration = GMDConfiguration(padded_frames=padded, padding_step=step)
    assert configuration.window(n_frames) == window


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"motion_widths": [12]}, "'motion_widths' must be one or more positive multiples of 8"),
        ({"trajectory_widths": []}, "'trajectory_widths' must be one or more"),
        ({"padded_frames": 100}, "'padded_frames' must be a multiple of 8"),
        ({"padding_step": 4}, "'padding_step' must be a multiple of 8"),
        ({"condition_width": 7}, "'condition_width' must be even"),
        ({"emphasis": 0.0}, "'emphasis' must be above 0"),
        ({"diffusion_steps": 0}, "'diffusion_steps' must be at least 1"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        GMDConfiguration(**{name: tuple(v) if isinstance(v, list) else v for name, v in change.items()})
