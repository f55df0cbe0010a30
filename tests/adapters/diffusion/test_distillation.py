"""Distillation: the student starts as its teacher, is told to end where the teacher ends, and comes to do so."""

from __future__ import annotations

from pathlib import Path

import msgspec
import numpy as np
import pytest
import torch

from prbench.errors import InputFileError, UsageError
from prbench_adapters import pr
from prbench_adapters.diffusion.configuration import DenoiserConfiguration, EncodedCondition
from prbench_adapters.diffusion.denoiser import FrameDenoiser
from prbench_adapters.diffusion.model import network
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim
from prbench_adapters.diffusion.tasks import Distillation, student_of, teacher_walks
from prbench_adapters.diffusion.training import DiffusionTraining
from prbench_adapters.training import SequenceDataset, collate
from prbench_adapters.training.dataset import MotionBatch
from prbench_adapters.training.task import TrainingData
from prbench_adapters.training.weights import write_weights
from tests.fakes import fake_dataset

STUDY = {
    "width": 16,
    "heads": 2,
    "layers": 2,
    "feed_forward": 24,
    "dropout": 0.0,
    "text_encoder": "hashed-ngrams",
    "text_dimension": 64,
    "goal": "location",
    "diffusion_steps": 6,
    "text_drop": 0.0,
}
FRAMES = {
    **STUDY,
    "architecture": "frames",
    "features": "goal-frame",
    "frames_per_token": 2,
    "ray_loss_weight": 2.0,
    "foot_loss_weight": 10.0,
    "wrist_loss_weight": 1.0,
}
KINDS = {"decoder": STUDY, "encoder": {**STUDY, "architecture": "encoder"}, "frames": FRAMES}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> SequenceDataset:
    folder = tmp_path_factory.mktemp("distillation")
    return SequenceDataset([fake_dataset(folder / "table", n=12)], cache=folder / "cache")


@pytest.fixture(scope="module")
def batch(data: SequenceDataset) -> MotionBatch:
    return collate([data[int(index)] for index in np.argsort(data.lengths)[:3]])


@pytest.fixture(scope="module", params=list(KINDS))
def teacher(request: pytest.FixtureRequest, data: SequenceDataset, tmp_path_factory: pytest.TempPathFactory):
    """The table of a model, and a weights file of it."""
    model = KINDS[request.param]
    module = _build(data, model, stage="finetune")
    for name, parameter in module.named_parameters():  # some parts start at zero, which would hide everything
        torch.nn.init.normal_(parameter, 1.0 if name.endswith("norm.weight") else 0.0, 0.1)
    return model, _saved(module, tmp_path_factory.mktemp("weights") / "teacher.safetensors")


def _build(
    data: SequenceDataset, model: dict, *, stage: str = "distil", initial: Path | None = None
) -> DiffusionTraining:
    torch.manual_seed(0)
    given = TrainingData(train=data, mode=data.mode, max_frames=data.max_frames, fps=data.fps)
    return pr.training_task().build(model, data=given, initial=initial, stage=stage)


def _saved(module: DiffusionTraining, path: Path) -> Path:
    tensors, metadata = module.weights()
    write_weights(path, tensors, metadata, {})
    return path


def _student(data: SequenceDataset, teacher: tuple[dict, Path], passes: int) -> Distillation:
    model, weights = teacher
    module = _build(data, {**model, "diffusion_steps": passes}, initial=weights)
    assert isinstance(module, Distillation)
    return module


def _told(module: DiffusionTraining, batch: MotionBatch) -> EncodedCondition:
    return module.condition(batch, torch.zeros(len(batch), dtype=torch.bool))


def _noise(module: DiffusionTraining, batch: MotionBatch) -> torch.Tensor:
    noise = torch.randn(len(batch), batch.padding.shape[1], module.denoiser.configuration.n_features)
    return noise.masked_fill(batch.padding[..., None], 0.0)


@torch.no_grad()
def test_each_pass_starts_as_the_teachers_step_of_the_same_noise(data, batch, teacher):
    module = _student(data, teacher, 3).eval()
    condition = _told(module, batch)
    noise = _noise(module, batch)
    for own, its in enumerate((1, 3, 5)):
        given = (condition, batch.n_frames)
        student = module.denoiser(noise, torch.full((len(batch),), own), *given)
        torch.testing.assert_close(
            student, module.teacher(noise, torch.full((len(batch),), its), *given), rtol=0, atol=1e-4
        )


@pytest.mark.parametrize("passes", [1, 2, 3])
@torch.no_grad()
def test_a_student_that_does_as_it_is_told_makes_the_teachers_motion(data, batch, teacher, passes):
    module = _student(data, teacher, passes)
    condition = _told(module, batch)
    start = _noise(module, batch)

    def taught(state: torch.Tensor, step: int) -> torch.Tensor:
        return module.wanted(state, torch.full((len(batch),), step), batch, condition)

    def teaches(state: torch.Tensor, step: int) -> torch.Tensor:
        return module.teacher(state, torch.full((len(batch),), step), condition, batch.n_frames)

    found = sample_ddim(taught, CosineSchedule(passes), start)
    expected = sample_ddim(teaches, CosineSchedule(6), start).masked_fill(batch.padding[..., None], 0.0)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)


def test_the_loss_falls_and_the_teacher_stays_as_it_is(data, batch, teacher):
    module = _student(data, teacher, 1)
    module.train()
    before = {name: values.clone() for name, values in module.teacher.state_dict().items()}
    learning = [parameter for parameter in module.parameters() if parameter.requires_grad]
    assert {id(parameter) for parameter in learning} == {id(parameter) for parameter in module.denoiser.parameters()}
    optimiser = torch.optim.AdamW(learning, lr=1e-2)
    found = []
    for _ in range(12):
        optimiser.zero_grad()
        loss = module(batch, 0)["loss"]
        loss.backward()
        optimiser.step()
        found.append(float(loss.detach()))
    assert found[-1] < 0.8 * found[0]
    assert not module.teacher.training
    assert all(torch.equal(values, before[name]) for name, values in module.teacher.state_dict().items())


def test_the_file_is_one_of_an_ordinary_model_of_few_steps_that_names_its_teacher(data, teacher):
    module = _student(data, teacher, 2)
    tensors, metadata = module.weights()
    configuration = msgspec.json.decode(metadata["configuration"], type=DenoiserConfiguration)
    assert configuration.diffusion_steps == 2
    own = network(configuration).state_dict()
    assert {name for name in tensors if name.startswith("denoiser.")} == {f"denoiser.{name}" for name in own}
    (line,) = (line for line in module.origin if line.startswith("distilled from"))
    assert "teacher.safetensors, sha256 " in line
    assert line.endswith("of 6 diffusion steps; network passes a motion: 2")


@pytest.mark.parametrize(
    ("total", "passes", "steps", "expected"),
    [
        (4, 1, 50, [[3, 2, 1, 0]]),
        (10, 2, 50, [[4, 3, 2, 1, 0], [9, 8, 7, 6, 5]]),
        (1000, 2, 4, [[499, 249], [999, 749]]),
        (1000, 4, 1, [[249], [499], [749], [999]]),
    ],
)
def test_the_teacher_walks_from_pass_to_pass(total, passes, steps, expected):
    assert teacher_walks(total, passes, steps).tolist() == expected


@pytest.mark.parametrize("passes", [1, 2, 3, 4])
@pytest.mark.parametrize("total", [5, 50, 1000])
def test_no_step_of_the_teacher_is_taken_twice(total, passes):
    walks = teacher_walks(total, passes, 50)
    assert len(np.unique(walks)) == walks.size
    assert walks.max() == total - 1
    assert walks.size <= 50


def test_a_teacher_of_a_thousand_steps_has_a_student(data):
    configuration = DenoiserConfiguration(**{key: FRAMES[key] for key in FRAMES if key in _FIELDS})
    teacher = FrameDenoiser(msgspec.structs.replace(configuration, diffusion_steps=1000))
    student = student_of(teacher, msgspec.structs.replace(configuration, diffusion_steps=4))
    assert isinstance(student, FrameDenoiser)
    kept = teacher.step_embedding.weight[[249, 499, 749, 999]]
    assert torch.equal(student.step_embedding.weight, kept)


_FIELDS = frozenset(DenoiserConfiguration.__struct_fields__)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"diffusion_steps": 5}, UsageError, r"expected 1 to 4 passes .* teacher has 6 steps, found 5"),
        ({"width": 32, "layers": 3}, InputFileError, r"--set model\.width=16 --set model\.layers=2"),
        ({"goal": "pose"}, InputFileError, r"configuration\.goal: .* --set model\.goal=location"),
    ],
)
def test_a_student_that_does_not_fit_its_teacher_is_refused(data, teacher, changes, error, message):
    model, weights = teacher
    with pytest.raises(error, match=message):
        _build(data, {**model, "diffusion_steps": 2, **changes}, initial=weights)


def test_a_student_needs_a_teacher_of_more_passes(data, teacher, tmp_path):
    with pytest.raises(UsageError, match=r"--stage distil: expected the teacher's weights, found none\. Add --init"):
        _build(data, {**STUDY, "diffusion_steps": 1})
    two = _saved(_student(data, teacher, 2), tmp_path / "two.safetensors")
    with pytest.raises(UsageError, match="expected 1 to 1 passes of a student whose teacher has 2 steps, found 2"):
        _build(data, {**teacher[0], "diffusion_steps": 2}, initial=two)
    one = _saved(_student(data, teacher, 1), tmp_path / "one.safetensors")
    with pytest.raises(UsageError, match="makes a motion in one pass already"):
        _build(data, {**teacher[0], "diffusion_steps": 1}, initial=one)
