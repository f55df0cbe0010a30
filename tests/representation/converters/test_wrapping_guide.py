"""The guide's adapters, run as they are printed, on invented models that know the motion which must come out."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.checking.doctor import Expected, diagnose
from prbench.checking.scaffold.create import (
    MADE_UP_WEIGHTS,
    ScaffoldRequest,
    filled,
    method_names,
    read_template,
    template_values,
)
from prbench.cli import main
from prbench.contract import Adapter, Condition, ConditionBatch, Motions
from prbench.errors import InputFileError
from prbench.files.storage import file_digest
from prbench.geometry.skeleton import Joint, z_up
from prbench.geometry.timelines import interpolate
from prbench.harness.methods.motions import at_native_rate, resampled
from prbench.harness.run_folder.record import RunRecord
from prbench.representation import canonicalise, encode
from prbench.representation.converters import (
    JointMap,
    RestJoints,
    SmplParameters,
    read_rest_joints,
    smpl_joints,
    to_canonical,
)
from prbench.representation.encoding import MIRRORED_JOINTS, retarget
from tests.fakes import fake_dataset
from tests.representation.converters.bodies import mean_error, person, person_rotations, write_body_model
from tests.representation.converters.foreign import known_motion, seen_as
from tests.representation.converters.test_smpl import written
from tests.representation.motions import turned

GUIDE = (Path(__file__).parents[3] / "docs" / "wrapping.md").read_text(encoding="utf-8")
LENGTHS = (80, 121)


def block(heading: str, language: str = "python") -> str:
    """The first code block below a heading of the guide."""
    found = re.search(rf"^## {heading}.*?^```{language}\n(.*?)^```", GUIDE, re.MULTILINE | re.DOTALL)
    assert found is not None, heading
    return found[1]


def load(heading: str, model: object, monkeypatch, **settings) -> Adapter:
    """The adapter of a section, with an invented model under the name that the guide imports."""
    module = types.ModuleType("glide_model")
    setattr(module, type(model).__name__, lambda *placed: model)
    monkeypatch.setitem(sys.modules, "glide_model", module)
    names: dict = {"__name__": "guide"}
    exec(compile(block(heading), "docs/wrapping.md", "exec"), names)
    weights = settings.get("weights")
    if weights is not None:
        torch.save({}, weights / "model.pt")
    return names["load"](weights, options=settings.get("options", {}), device="cpu")


# By what a model puts out: the section of the guide whose block `prbench adapters new --from` writes, and its names.
WRITTEN = {
    "joints22": ("A model with 22 joints", {"name": "mine", "class": "Mine", "model": "my_model"}),
    "hml263": ("1. HumanML3D features", {"name": "glide", "class": "Glide", "model": "glide_model"}),
    "smplx": ("2. SMPL parameters", {"name": "glide", "class": "Glide", "model": "glide_model"}),
}


@pytest.mark.parametrize("source", MADE_UP_WEIGHTS)
def test_a_new_package_holds_the_block_that_the_guide_explains(source) -> None:
    heading, names = WRITTEN[source]
    values = template_values(method_names("glide"), ScaffoldRequest("glide", source=source))
    template = read_template(f"from_{source}.py")
    assert filled(template, {**values, **names}, {"goal"}) == block(heading)


def batch_of(motions: list[np.ndarray]) -> ConditionBatch:
    """Conditions of canonical motions; the text tells the invented model which one is meant."""
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        n_frames=np.array([len(motion) for motion in motions]),
        fps=20.0,
        opaque_id=tuple("ab"),
        noise_seed=(1, 2),
        text=("0", "1"),
        initial_joints=np.stack([motion[0] for motion in motions]),
        previous_joints=np.stack([motion[0] for motion in motions]),
        goal_location=np.stack([motion[-1, Joint.RIGHT_WRIST] for motion in motions]).astype(np.float64),
    )


def errors(found: Motions, motions: list[np.ndarray]) -> list[float]:
    assert found.joints.dtype == np.float32
    return [mean_error(found.joints[row, : len(motion)], motion) for row, motion in enumerate(motions)]


def two_motions() -> list[np.ndarray]:
    joints, _ = known_motion()
    return [canonicalise(joints[:80].astype(np.float32)), canonicalise(joints[100:221].astype(np.float32))]


NETWORK = """
import torch

class Network(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.speed = torch.nn.Parameter(torch.zeros(()))

    def forward(self, initial, goal, n_frames, noise):
        steps = self.speed * torch.arange(n_frames)[:, None, None] * torch.randn(3, generator=noise)
        return initial + steps + 0 * goal.float()
"""


def test_a_network_of_ones_own_is_checked_and_run(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "mine.py").write_text(block("A model with 22 joints"), encoding="utf-8")
    (tmp_path / "my_model.py").write_text(NETWORK, encoding="utf-8")
    torch.save({"speed": torch.tensor(0.001)}, tmp_path / "mine.pt")
    table = fake_dataset(tmp_path / "table", 24)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    method = ["./mine.py", "--weights", "mine.pt"]
    assert main(["adapters", "check", *method]) == 0
    assert "failed" not in capsys.readouterr().out.replace("0 failed", "")
    run = ["run", "--method", *method, "--condition", "goal-loc", "--data", str(table.folder), "--out", "run"]
    assert main(run) == 0
    assert "mine (package mine.py" in capsys.readouterr().out
    assert RunRecord.read(tmp_path / "run").method.weights_digest == file_digest(tmp_path / "mine.pt")
    assert main(["adapters", "check", "./mine.py"]) == 5
    assert "mine needs --weights FILE and has no options" in capsys.readouterr().out


class FeatureModel(torch.nn.Module):
    """Knows the motions on HumanML3D's skeleton, as standardised features in MDM's layout."""

    def __init__(self, motions, mean, std) -> None:
        super().__init__()
        self.motions, self.mean, self.std, self.goals = motions, mean, std, None

    def sample(self, text, goals, n_frames, rows) -> torch.Tensor:
        self.goals = goals.numpy()
        output = np.full((len(text), 263, 1, rows), 9.9, dtype=np.float32)
        for row, name in enumerate(text):
            own = canonicalise(retarget(self.motions[int(name)]))
            features = (encode(own, next_joints=own[-1]) - self.mean) / self.std
            output[row, :, 0, : n_frames[row]] = features.T
        return torch.from_numpy(output)


def test_situation_1_features(tmp_path, monkeypatch) -> None:
    motions = two_motions()
    rng = np.random.default_rng(0)
    mean, std = rng.normal(size=263).astype(np.float32), rng.uniform(0.01, 0.5, size=263).astype(np.float32)
    np.save(tmp_path / "Mean.npy", mean)
    np.save(tmp_path / "Std.npy", std)
    model = FeatureModel(motions, mean, std)
    adapter = load("1. HumanML3D", model, monkeypatch, weights=tmp_path)
    assert isinstance(adapter, Adapter)
    assert max(errors(adapter.generate(batch_of(motions), seed=0), motions)) < 1e-3
    uniform = [retarget(motion)[-1, Joint.PELVIS] for motion in motions]
    ratio = [np.linalg.norm(a) / np.linalg.norm(m[-1, Joint.PELVIS]) for a, m in zip(uniform, motions, strict=True)]
    assert np.allclose(model.goals, batch_of(motions).goal_location * np.array(ratio)[:, None], rtol=1e-3)


BETAS = np.linspace(-1, 1, 10)


class SmplxParameterModel(torch.nn.Module):
    """Knows rotations at 30 fps; its world has Z up, and every sample stands and faces elsewhere."""

    def __init__(self, rotations, pelvis, rest) -> None:
        super().__init__()
        self.rotations, self.pelvis, self.rest, self.goals = rotations, pelvis, rest, []

    def sample(self, text, goal, n_frames) -> dict[str, torch.Tensor]:
        self.goals.append(goal.numpy())
        first = 60 * int(text)
        part = slice(first, first + n_frames)
        world = self.rotations[part].copy()
        turn = _z_up_and_turned(0.9)
        world[:, 0] = turn @ world[:, 0]
        numbers = written(world, "6d-rows").reshape(len(world), 22, 6)
        transl = self.pelvis[part] @ turn.T + np.array([4.0, -2.0, 0.3]) - self.rest
        arrays = {"global_orient": numbers[:, 0], "body_pose": numbers[:, 1:], "transl": transl, "betas": BETAS}
        return {name: torch.from_numpy(values) for name, values in arrays.items()}


def _z_up_and_turned(yaw: float) -> np.ndarray:
    """Rotation from Y up to Z up, about the vertical too."""
    return np.stack([z_up(turned(axis[None], yaw))[0] for axis in np.eye(3)], axis=1)


@pytest.fixture
def smplx_motions(tmp_path):
    """Known motions at 30 fps, the invented model of them, and its body model file."""
    path = tmp_path / "SMPLX_NEUTRAL.npz"
    write_body_model(path, joints=55, shapes=20)
    rest = read_rest_joints(path).of(BETAS)
    joints, rotations = person_rotations(400, 300)
    pose = SmplParameters.from_poses(written(rotations, "matrix"), joints[:, 0] - rest[0], form="matrix")
    body = smpl_joints(pose, RestJoints.fixed(rest))
    model = SmplxParameterModel(rotations, joints[:, 0], rest[0])
    return body, model, path


def test_situation_2_smpl_parameters(smplx_motions, monkeypatch) -> None:
    body, model, path = smplx_motions
    motions = []
    for row, n in enumerate(LENGTHS):
        native = body[60 * row : 60 * row + int(np.ceil((n - 1) * 1.5)) + 1]
        at_20 = interpolate(np.arange(len(native)) / 30, native, np.arange(n) / 20)
        frame = canonicalise(np.concatenate([at_20, native]))  # one canonical frame for both rates
        motions.append(frame[:n].astype(np.float32))
    adapter = load("2. SMPL", model, monkeypatch, weights=path.parent, options={"smplx_model": str(path)})
    batch = batch_of(motions)
    native = adapter.generate(at_native_rate(batch, adapter.native_fps), seed=0)
    found = resampled(native, batch.n_frames, step=adapter.native_fps / batch.fps)
    assert max(errors(found, motions)) < 1e-4
    assert np.allclose(model.goals, z_up(batch.goal_location))


class JointModel:
    """Knows the motions as Human3.6M's joints, in millimetres of a camera, at 60 fps."""

    def __init__(self, starts) -> None:
        self.seen, self.starts = seen_as("h36m-17"), starts

    def sample(self, text, n_frames, seed) -> np.ndarray:
        times = self.starts[int(text)] / 20 + np.arange(n_frames) / 60
        world = interpolate(np.arange(len(self.seen)) / 20, self.seen, times)
        return (world * np.array([1, -1, -1]) + np.array([0.3, 1.4, 5.0])) * 1000


def test_situation_3_joints_of_another_skeleton(tmp_path, monkeypatch) -> None:
    motions = two_motions()
    adapter = load("3. Joints", JointModel((0, 100)), monkeypatch, weights=tmp_path)
    found = adapter.generate(batch_of(motions), seed=0)
    assert max(errors(found, motions)) < 0.025
    for row, motion in enumerate(motions):
        wrists = found.joints[row, : len(motion), 20:22] - motion[:, 20:22]
        assert np.linalg.norm(wrists, axis=-1).mean() < 0.04


def at_places(motion: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """The motion at fractional frame numbers."""
    return interpolate(np.arange(len(motion), dtype=np.float64), motion.astype(np.float64), frames)


CHAIN_ORDER = [0, 2, 5, 8, 11, 1, 4, 7, 10, 3, 6, 9, 12, 15, 14, 17, 19, 21, 13, 16, 18, 20]
MISTAKES = {
    "millimetres": (lambda motion: motion * 1000, "unit", "This looks like mm"),
    "Z up": (z_up, "up-axis", "bodies along +y"),
    "another frame rate": (lambda motion: at_places(motion, np.arange(len(motion)) * 2 / 3), "frame-rate", None),
    "facing elsewhere": (lambda motion: turned(motion, 1.5), "facing", None),
    "above the floor": (lambda motion: motion + np.array([0, 0.4, 0]), "floor", None),
    "order of the joints": (lambda motion: motion[:, CHAIN_ORDER], "joint-order", "The order of the joints is another"),
    "left and right exchanged": (lambda motion: motion[:, MIRRORED_JOINTS], "left-right", "left and right"),
    "a left-handed world": (lambda motion: motion * np.array([1, 1, -1]), "mirrored", "left and right"),
    "a clock that stumbles": (
        lambda motion: at_places(motion, np.round(np.arange(len(motion)) * 0.66) / 0.66), "clock", None
    ),
}  # fmt: skip
"""What goes wrong, done to a canonical motion; the doctor's diagnosis, and the converter's message if it has one."""


def test_recorded_motions_have_none_of_the_faults() -> None:
    motions = five_motions()
    assert diagnose(motions, [known_of(motion) for motion in motions], fps=20.0) == ()


def five_motions() -> list[np.ndarray]:
    """Parts of a person's motion, five seconds each, at 20 frames a second (recorded at 120)."""
    return [canonicalise(person(600, start)[::6]) for start in (300, 475, 650, 800, 1000)]


def known_of(motion: np.ndarray) -> Expected:
    return Expected(initial_joints=motion[0], previous_joints=2 * motion[0] - motion[1], n_frames=len(motion), fps=20.0)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_the_doctor_and_the_converter_name_each_mistake(mistake) -> None:
    change, kind, told = MISTAKES[mistake]
    motions = five_motions() * 4  # five are too few to tell a frame rate from chance
    found = diagnose([change(motion) for motion in motions], [known_of(motion) for motion in motions], fps=20.0)
    assert kind in {diagnosis.kind for diagnosis in found}
    if told is not None:
        with pytest.raises(InputFileError, match=re.escape(told)):
            to_canonical(np.asarray(change(motions[0]), dtype=np.float32), 20.0)


@pytest.mark.parametrize(
    ("heading", "message"),
    [("1. HumanML3D", "needs --weights DIR"), ("2. SMPL", r"needs --weights DIR \(model.pt\) and --option")],
)
def test_what_an_adapter_needs_it_says(heading, message, monkeypatch) -> None:
    with pytest.raises(ValueError, match=message):
        load(heading, object(), monkeypatch)


def test_samplers_without_a_generator_obey_the_noise_seed() -> None:
    names: dict = {}
    exec(compile(block("A sampler that takes no generator"), "docs/wrapping.md", "exec"), names)
    batch = batch_of(two_motions())

    def sampler(texts):
        return [row + torch.randn_like(row) for row in torch.randn(len(texts), 3)]

    def batched(texts):
        noise = torch.randn(len(texts), 3)
        return noise + torch.randn_like(noise)

    for name, each in (("one_at_a_time", sampler), ("all_at_once", batched)):
        together = names[name](each, batch)
        torch.rand(3)
        alone = [names[name](each, batch.rows(row, row + 1))[0] for row in (1, 0)]
        assert torch.equal(torch.stack(list(together)), torch.stack(alone[::-1])), name
        assert not torch.equal(together[0], together[1])


def test_the_map_of_the_guide_is_a_map() -> None:
    names: dict[str, JointMap] = {}
    exec(next(text for text in re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL) if "my-rig" in text), names)
    own = names["rig"]
    assert own.name == "my-rig"
    assert own.expressions[Joint.HEAD].axes == (("@up", -0.1),)
    assert set(own.completed) == {
        Joint.SPINE1, Joint.SPINE2, Joint.LEFT_COLLAR, Joint.RIGHT_COLLAR, Joint.LEFT_FOOT, Joint.RIGHT_FOOT,
    }  # fmt: skip


def test_every_function_that_the_guide_names_exists() -> None:
    from prbench.representation import converters

    imported = re.findall(r"^    (\w+),$", GUIDE, re.MULTILINE)
    assert len(imported) > 10
    spoken = set(re.findall(r"`(\w+)\(", GUIDE)) - {"motion"}
    known = {*converters.__all__, "rest_offsets", "generate"}
    assert spoken <= known
