"""Goals, imputation and both stages of sampling: random networks, the original's steps, whole stages of the page."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from torch import Tensor

from prbench.contract import ConditionBatch
from prbench.geometry.skeleton import Joint
from prbench.harness.methods.loading import load_adapter
from prbench_adapters.diffusion.generation import SequenceNoise
from prbench_adapters.diffusion.model import SMOOTHINGS
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.gmd import sampling
from prbench_adapters.gmd.adapter import generate
from prbench_adapters.gmd.model import ROOT_XZ, FeatureSpace, decode_absolute, emphasis_projection, with_absolute_root
from prbench_adapters.gmd.sampling import (
    Ends,
    GMDSettings,
    GuidedNetwork,
    RootGoal,
    clean_of_noise,
    guided_mean,
    imputed_by_noising,
    imputed_in_mean,
    imputed_root,
    noised,
    sample_motion,
    sample_trajectory,
)
from tests.adapters.gmd import golden, page, tiny


def _ends() -> Ends:
    first, last = torch.zeros(2, 22, 3), torch.zeros(2, 22, 3)
    last[0, Joint.PELVIS] = torch.tensor([1.0, 0.9, 2.0])
    last[1, Joint.PELVIS] = torch.tensor([0.0, 0.8, -3.0])
    return Ends(first, last, torch.tensor([5, 3]))


def test_keyframes_are_the_first_and_the_last_frame_of_each_motion():
    goal = _ends().root_keyframes()
    assert goal.wanted.tolist() == [[True, False, False, False, True], [True, False, True, False, False]]
    assert goal.xz[0, [0, 4]].tolist() == [[0, 0], [1, 2]]
    assert goal.xz[1, [0, 2]].tolist() == [[0, 0], [0, -3]]


def test_only_the_ground_position_of_the_root_is_imputed():
    space, goal = tiny.space(), _ends().root_keyframes()
    values, where = imputed_root(goal, space, 263)
    assert where[0, 4].nonzero().flatten().tolist() == [1, 2]
    assert int(where.sum()) == 2 * 4
    restored = space.restored(values)
    assert torch.allclose(restored[where], torch.tensor([0.0, 0, 1, 2, 0, 0, 0, -3]), atol=1e-6)


def _root(joints: np.ndarray) -> np.ndarray:
    return joints[:, Joint.PELVIS, ::2]


def _errors(batch: ConditionBatch, joints: np.ndarray) -> np.ndarray:
    """Distance of the root to its first and its last keyframe, metres."""
    assert batch.goal_joints is not None
    assert batch.initial_joints is not None
    last = joints[np.arange(len(batch)), batch.n_frames - 1]
    ends = ((joints[:, 0], batch.initial_joints), (last, batch.goal_joints))
    return np.array([np.linalg.norm(_root(found) - _root(wanted), axis=1) for found, wanted in ends])


@pytest.fixture(scope="module")
def model():
    return tiny.model()


@pytest.mark.parametrize(("keyframes", "seed"), [("root", 1), ("pose", 2)])
def test_the_root_is_at_its_keyframes_whatever_the_networks_say(keyframes, seed):
    batch = tiny.batch()
    motions = generate(tiny.model(seed=seed), batch, GMDSettings(keyframes=keyframes, steps=5))
    assert _errors(batch, motions.joints).max() < 1e-3


def test_a_path_beside_its_keyframes_is_bent_to_them_and_does_not_jump():
    goal = RootGoal(torch.tensor([[[0.0, 0], [9, 9], [9, 9], [3, 1]]]), torch.tensor([[True, False, False, True]]))
    bent = goal.bent(torch.tensor([[[-0.3, 0], [0.7, 0], [1.7, 0], [2.4, 1]]]))
    assert torch.allclose(bent[0], torch.tensor([[0.0, 0], [1.1, 0], [2.2, 0], [3, 1]]), atol=1e-6)
    way = torch.zeros(1, 40, 4)
    way[0, :, 2] = torch.linspace(0, 1, 40)
    way[0, 30:, 2] += 0.3
    keyframes = RootGoal(way[..., 1:3], torch.arange(40)[None] % 30 == 0)
    way[0, 31:, 2] -= 0.3
    found = sampling.without_jumps(way, keyframes, torch.tensor([31]))
    assert torch.allclose(found[0, [0, 30], 2], way[0, [0, 30], 2], atol=1e-6)
    assert found[0, :31, 2].diff().max() < 0.2 * way[0, :31, 2].diff().max()
    assert torch.equal(found[..., [0, 3]], way[..., [0, 3]])


def test_another_goal_moves_the_end_there(model):
    batch = tiny.batch()
    assert batch.goal_joints is not None
    shuffled = dataclasses.replace(batch, goal_joints=batch.goal_joints[[1, 2, 0]])
    joints = generate(model, shuffled, GMDSettings(steps=5)).joints
    assert _errors(shuffled, joints)[1].max() < 0.1
    assert _errors(batch, joints)[1].min() > 0.2


def test_whole_poses_are_met_when_they_are_imputed(model):
    batch = tiny.batch()
    joints = generate(model, batch, GMDSettings(keyframes="pose", steps=5)).joints
    last = joints[np.arange(3), batch.n_frames - 1]
    assert np.allclose(joints[:, 0], batch.initial_joints, atol=1e-3)
    assert np.allclose(last, batch.goal_joints, atol=1e-3)
    rooted = generate(model, batch, GMDSettings(steps=5)).joints
    assert not np.allclose(rooted[:, 0], batch.initial_joints, atol=0.1)


def test_the_body_follows_the_whole_trajectory(model, monkeypatch):
    followed = []
    trajectory_stage = sampling.without_jumps

    def watched(*arguments, **keywords):
        followed.append(trajectory_stage(*arguments, **keywords))
        return followed[-1]

    monkeypatch.setattr("prbench_adapters.gmd.adapter.without_jumps", watched)
    joints = generate(model, tiny.batch((24,)), GMDSettings(steps=5)).joints
    assert np.allclose(_root(joints[0]), followed[0][0, :, 1:3].numpy(), atol=1e-4)


def test_the_goal_scale_matters_and_zero_takes_no_gradient(model, monkeypatch):
    short = generate(model, tiny.batch((2, 1)), GMDSettings(steps=5)).joints
    assert np.isfinite(short[0, :2]).all()
    assert np.isfinite(short[1, :1]).all()
    batch = tiny.batch((12,))
    guided = generate(model, batch, GMDSettings(steps=5)).joints
    monkeypatch.setattr(torch.autograd, "grad", None)
    free = generate(model, batch, GMDSettings(steps=5, goal_scale=0.0)).joints
    assert not np.allclose(guided, free, atol=1e-3)


def test_smoothed_motions_average_neighbouring_frames_and_keep_their_keyframes():
    batch = tiny.batch((14, 9))
    plain, smooth = (generate(tiny.model(smoothed=each), batch, GMDSettings(steps=2)).joints for each in (False, True))
    for row, n in enumerate(batch.n_frames):
        pelvis, expected = smooth[row, :n, 0], plain[row, :n, 0].copy()
        for _ in range(SMOOTHINGS):
            expected[1:-1] = (expected[:-2] + 2 * expected[1:-1] + expected[2:]) / 4
        assert np.allclose(pelvis, expected, atol=1e-5)


def test_options_reach_the_settings(tmp_path):
    weights = tiny.write(tmp_path / "tiny.safetensors")
    given = {"keyframes": "pose", "guidance": "1", "goal-scale": "30", "steps": "7"}
    assert load_adapter("gmd", weights, given, "cpu").settings == GMDSettings(1.0, 30.0, "pose", 7)


def test_each_step_imputes_and_guides_as_its_noise_asks(monkeypatch):
    """100 steps: the line while t ≥ 10, then the keyframes; gradients while t ≥ 2; a body of five frames follows."""
    imputed: list[list[tuple[int, int]]] = [[], []]
    guided: list[int] = []

    def noising(chain, i, state, overwritten, noise):
        imputed[0].append((i, int(overwritten[1][0].any(dim=1).sum())))
        return state

    def in_mean(space, chain, i, state, mean, overwritten):
        imputed[1].append((i, int(overwritten[1][0].any(dim=1).sum())))
        return mean

    def mean_of(estimate, chain, i, state, loss, scale):
        guided.extend([i] if loss is not None else [])
        return state

    monkeypatch.setattr(sampling, "imputed_by_noising", noising)
    monkeypatch.setattr(sampling, "imputed_in_mean", in_mean)
    monkeypatch.setattr(sampling, "guided_mean", mean_of)
    model, ends, settings = tiny.model(diffusion_steps=100), _ends(), GMDSettings()
    noise = SequenceNoise([1, 2], ends.n_frames.numpy())
    text, window = torch.zeros(2, 64), model.configuration.window(5)
    network = sampling.GuidedNetwork(model.networks.motion, text, ends.n_frames, window=window, scale=1.0)
    trajectory = sampling.sample_trajectory(
        network, model.schedule, model.space, ends.root_keyframes(), noise, settings
    )
    sampling.sample_motion(network, model.schedule, model.space, trajectory, ends, noise, settings)

    line = [(t, 5) for t in range(99, 9, -1)]
    assert imputed[0] == line + [(t, 2) for t in range(9, -1, -1)]
    assert imputed[1] == [(t, 5) for t in range(99, -1, -1)]
    assert guided == 2 * list(range(99, 1, -1))


AT = 250
SCHEDULE = CosineSchedule(golden.STEPS)


@dataclass(frozen=True)
class Case:
    """One file as our objects."""

    arrays: dict[str, np.ndarray]
    space: FeatureSpace
    goal: RootGoal

    @property
    def state(self) -> Tensor:
        return golden.features(self.arrays["x_t"])

    def network(self, scale: float) -> GuidedNetwork:
        text, frames = torch.from_numpy(self.arrays["text"]), self.arrays["x_t"].shape[2]
        n_frames = torch.full((len(text),), frames)
        return GuidedNetwork(golden.network(self.arrays), text, n_frames, window=golden.WINDOW, scale=scale)


def _case(samples, name: str) -> Case:
    arrays = golden.load(samples, name)
    projection = arrays.get("projection", np.eye(263)).astype(np.float32)
    space = FeatureSpace.of(*(torch.from_numpy(array) for array in (arrays["mean"], arrays["std"], projection)))
    wanted = torch.zeros(arrays["target_xz"].shape[:2], dtype=torch.bool)
    wanted[:, arrays["target_frames"]] = True
    return Case(arrays, space, RootGoal(torch.from_numpy(arrays["target_xz"]), wanted))


@pytest.mark.parametrize("name", ["gmd_motion_step", "gmd_trajectory_step"])
@pytest.mark.parametrize(("output", "scale"), [("network_output", 1.0), ("network_output_guided", 2.5)])
def test_networks_predict_what_the_original_ones_do(samples, name, output, scale):
    case = _case(samples, name)
    found = case.network(scale)(case.state, AT)
    assert (found - golden.features(case.arrays[output])).abs().max() < 1e-5


def _trajectory_step(case: Case, *, scale: float = 100.0, impute: bool = True) -> Tensor:
    network, state = case.network(2.5), case.state
    mean = guided_mean(
        lambda noisy, step: clean_of_noise(SCHEDULE, step, noisy, network(noisy, step)),
        SCHEDULE,
        AT,
        state,
        lambda clean: case.goal.loss(case.space.restored(clean)[..., ROOT_XZ]),
        scale,
    )
    after = noised(SCHEDULE, AT, mean, golden.features(case.arrays["noise"]))
    if not impute:
        return after
    imputed, noise = imputed_root(case.goal, case.space, 4), golden.features(case.arrays["imputation_noise"])
    return imputed_by_noising(SCHEDULE, AT, after, imputed, noise)


def _motion_step(case: Case, *, scale: float = 100.0, impute: bool = True) -> Tensor:
    mean = guided_mean(
        case.network(2.5),
        SCHEDULE,
        AT,
        case.state,
        lambda clean: case.goal.loss(case.space.restored(case.space.unprojected(clean))[..., ROOT_XZ]),
        scale,
    )
    if impute:
        imputed = imputed_root(case.goal, case.space, 263)
        mean = imputed_in_mean(case.space, SCHEDULE, AT, case.state, mean, imputed)
    return noised(SCHEDULE, AT, mean, golden.features(case.arrays["noise"]))


def test_steps_are_the_original_ones_and_guidance_and_imputation_matter_more_than_the_tolerances(samples):
    """The original inverts the projection in float32, so a motion's step agrees less well."""
    for step, name, tolerance in ((_trajectory_step, "trajectory", 1e-5), (_motion_step, "motion", 1e-4)):
        case = _case(samples, f"gmd_{name}_step")
        expected = golden.features(case.arrays["x_prev"])
        assert (step(case) - expected).abs().max() < tolerance
        for change in ({"scale": 0.0}, {"scale": 50.0}, {"impute": False}):
            assert (step(case, **change) - expected).abs().max() > 2 * tolerance


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
    expected = page.predicted(weights, x, 37, text, frames=window, levels=3, steps=50)
    given = (torch.from_numpy(x)[None], torch.tensor([37]), torch.from_numpy(text)[None], torch.tensor([frames]))
    assert np.allclose(network(*given, window=window)[0].numpy(), expected, atol=1e-9)


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
