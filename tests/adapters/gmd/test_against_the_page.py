"""What docs/specification/gmd.md says beyond the golden cases: schedules, lengths, keyframes, losses; whole samplings.

Everything is compared with :mod:`tests.adapters.gmd.page`, in double precision.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from prbench_adapters.diffusion.generation import SequenceNoise
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd.model import FeatureSpace, decode_absolute, emphasis_projection, with_absolute_root
from prbench_adapters.gmd.sampling import Ends, GMDSettings, GuidedNetwork, RootGoal, sample_motion, sample_trajectory
from tests.adapters.gmd import page, page_network, tiny

FRAMES = 13  # no multiple of what the networks divide by
KEYFRAMES = page.Keyframes({0: (0.0, 0.0), 4: (0.7, -0.4), 10: (1.1, 0.9)})


class Linear(GuidedNetwork):
    """x ↦ M x K in place of a network with its text."""

    def __init__(self, stage: page.Stage) -> None:
        self.over_frames, self.over_columns = map(torch.from_numpy, (stage.over_frames, stage.over_columns))
        self.asked: list[int] = []

    def __call__(self, noisy: torch.Tensor, step: int) -> torch.Tensor:
        self.asked.append(step)
        return self.over_frames @ noisy @ self.over_columns


class Given(SequenceNoise):
    """Noise that the test knows too."""

    def __init__(self, draws: list[np.ndarray]) -> None:
        self._draws: Iterator[np.ndarray] = iter(draws)

    def draw(self, columns: int = 263) -> torch.Tensor:
        return torch.from_numpy(next(self._draws))[None]


def _stage(columns: int, steps: int, *, gain: float, **changes: object) -> page.Stage:
    """A network that hands on a part of what it sees, stirred over frames and columns."""
    generator = np.random.default_rng(columns)
    stirred = [np.eye(n) + generator.normal(size=(n, n)) * 0.3 / n**0.5 for n in (FRAMES, columns)]
    mean, std = np.linspace(-0.1, 0.1, 263)[:columns], np.linspace(0.3, 0.5, 263)[:columns]
    return page.Stage(steps, gain * stirred[0], stirred[1], mean, std, **changes)


def _draws(n: int, columns: int) -> list[np.ndarray]:
    generator = np.random.default_rng(8)
    return [generator.standard_normal((FRAMES, columns)) for _ in range(n)]


def _space(stage: page.Stage) -> FeatureSpace:
    """With all 263 columns, also where the stage has four."""
    full = (np.linspace(-0.1, 0.1, 263), np.linspace(0.3, 0.5, 263))
    return FeatureSpace.of(*map(torch.from_numpy, full), emphasis_projection(10.0).double())


def _goal(keyframes: page.Keyframes) -> RootGoal:
    xz, wanted = torch.zeros(1, FRAMES, 2, dtype=torch.float64), torch.zeros(1, FRAMES, dtype=torch.bool)
    for n, place in keyframes.at.items():
        xz[0, n], wanted[0, n] = torch.tensor(place, dtype=torch.float64), True
    return RootGoal(xz, wanted)


@pytest.mark.parametrize("steps", [100, 1000])
def test_the_whole_first_stage_is_that_of_the_page(steps):
    """Three keyframes, the last of them not in the last frame; the clean estimate is often clamped."""
    stage, draws = _stage(4, steps, gain=0.8), _draws(2 * steps + 1, 4)
    network, settings = Linear(stage), GMDSettings()
    found = sample_trajectory(network, CosineSchedule(steps), _space(stage), _goal(KEYFRAMES), Given(draws), settings)
    assert np.allclose(found[0].numpy(), page.trajectory(stage, KEYFRAMES, draws), rtol=1e-7, atol=1e-7)
    assert network.asked == list(range(steps))[::-1]


def test_the_whole_second_stage_is_that_of_the_page():
    stage, draws = _stage(263, 100, gain=0.5), _draws(101, 263)
    space, settings = _space(stage), GMDSettings()
    followed = np.random.default_rng(2).normal(size=(FRAMES, 4)).cumsum(axis=0) * 0.2
    ends = Ends(torch.zeros(1, 22, 3), torch.zeros(1, 22, 3), torch.tensor([FRAMES]))
    root = torch.from_numpy(followed)[None]
    found = sample_motion(Linear(stage), CosineSchedule(100), space, root, ends, Given(draws), settings)
    expected = page.motion(stage, space.projection.numpy(), followed[:, 1:3], draws)
    assert np.allclose(found[0].numpy(), expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("steps", [10, 50, 100, 1000])
def test_posterior_means_and_variances_are_the_small_ones(steps):
    schedule = CosineSchedule(steps)
    expected = [page.Posterior.at(t, steps) for t in range(steps)]
    assert np.allclose(schedule.posterior_variance, [each.variance for each in expected], rtol=1e-9, atol=1e-15)
    assert np.allclose(schedule.posterior_mean_clean, [each.clean for each in expected], rtol=1e-9)
    assert np.allclose(schedule.posterior_mean_noisy, [each.noisy for each in expected], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("places", [[12], [0, 12], [3], [0, 5, 6, 11], [2, 7]])
def test_the_line_goes_through_all_keyframes_and_ends_at_the_last(places):
    generator = np.random.default_rng(len(places))
    keyframes = page.Keyframes({n: tuple(generator.normal(size=2)) if n else (0.0, 0.0) for n in places})
    line, expected = _goal(keyframes).line(), keyframes.line(FRAMES)
    assert line.wanted[0].nonzero().flatten().tolist() == list(expected)
    assert np.allclose(line.xz[0, : places[-1] + 1].numpy(), list(expected.values()), atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "channels", "frames"), [("motion", 263, 13), ("trajectory", 4, 16), ("motion", 263, 19)]
)
def test_networks_are_those_of_the_page(kind, channels, frames):
    """Three levels of three widths; lengths that are padded to 16, and one that is padded to 24."""
    made = tiny.networks(motion_widths=(16, 8, 24), trajectory_widths=(8, 24, 16), padding_step=8)
    network, window = getattr(made, kind).double(), made.configuration.window(frames)
    generator = np.random.default_rng(4)
    x, text = generator.normal(size=(frames, channels)), generator.normal(size=64)
    weights = {name: value.numpy() for name, value in network.state_dict().items()}
    expected = page_network.predicted(weights, x, 37, text, frames=window, levels=3, steps=50)
    given = (torch.from_numpy(x)[None], torch.tensor([37]), torch.from_numpy(text)[None], torch.tensor([frames]))
    assert np.allclose(network(*given, window=window)[0].numpy(), expected, atol=1e-9)


@pytest.mark.parametrize("scale", [0.0, 1.0, 2.5])
def test_guidance_goes_from_the_prediction_without_text_past_the_one_with_it(scale):
    network, generator = tiny.networks().trajectory, torch.Generator().manual_seed(1)
    x, text = (torch.randn(size, generator=generator) for size in ((2, FRAMES, 4), (2, 64)))
    n_frames, step = torch.tensor([FRAMES, 9]), torch.tensor([31, 31])
    with_text, without = (network(x, step, words, n_frames, window=16) for words in (text, torch.zeros(2, 64)))
    found = GuidedNetwork(network, text, n_frames, window=16, scale=scale)(x, 31)
    assert torch.allclose(found, without + scale * (with_text - without), atol=1e-5)
    assert (with_text - without).abs().max() > 1e-3


def test_the_projection_weighs_the_three_absolute_columns_ten_times_and_no_others():
    """A step of one standard deviation in one feature, as the motion network sees it; y = x·A, not A·x."""
    space = tiny.space()
    seen = space.projected(torch.eye(263)).norm(dim=1)
    assert float(seen[:3].min()) > 6.0
    assert float(seen[3:].max()) < 1.0
    drawn = space.projection.double().numpy() * np.sqrt(263 - 3 + 3 * 10**2)
    assert drawn[3:].std() == pytest.approx(1.0, abs=0.01)
    assert drawn[:3].std() == pytest.approx(10.0, rel=0.1)
    plain = np.random.default_rng(0).normal(size=(40, 263))
    decoded = space.unprojected(space.projected(torch.from_numpy(plain).float())).double().numpy()
    assert np.abs(decoded - plain).max() < 1e-3
    assert np.abs(plain @ drawn / np.sqrt(560) @ np.linalg.inv(drawn / np.sqrt(560)) - plain).max() < 1e-9


@pytest.mark.parametrize("case", ["straight", "turn90", "child", "long"])
def test_absolute_features_of_published_motions_lead_to_the_published_joints(samples, case):
    """The golden features of HumanML3D; their roots by quaternions, as the page writes them."""
    with np.load(samples / "humanml3d" / "golden" / f"golden_{case}.npz", allow_pickle=False) as file:
        relative, expected = file["features"].astype(np.float64), file["recovered_ric"]
    absolute = with_absolute_root(torch.from_numpy(relative))
    assert np.allclose(absolute[:, :3].numpy(), page.absolute_root(relative), atol=1e-9)
    assert np.array_equal(absolute[:, 3:].numpy(), relative[:, 3:])
    found = decode_absolute(absolute).numpy()
    assert np.allclose(found, page.joints(absolute.numpy()), atol=1e-9)
    assert np.allclose(found, expected, atol=2e-5)
