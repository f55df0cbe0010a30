"""The guest keeps prbench's contract: on a made-up checkout, and on the user's own with random weights."""

from __future__ import annotations

import importlib.util
import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import prbench_guest_mdm as guest
import pytest
import torch

from prbench.checking.conformance.cases import write_synthetic_table
from prbench.checking.conformance.suite import AdapterConformance
from prbench.contract import Condition, ConditionBatch
from prbench.representation import encode
from prbench.sequences import SequenceTable

MODULE = Path(guest.__file__)
PUBLIC = os.environ.get("PUBLIC_MDM")

# A checkout with the interface that the guest uses: same names, a denoiser of one layer.
MADE_UP = {
    "model/rotation2xyz.py": "raise ImportError('opens a body model')",
    "utils/parser_util.py": """
def add_data_options(parser):
    parser.add_argument("--dataset", default="humanml")

def add_model_options(parser):
    parser.add_argument("--unconstrained", action="store_true")
    parser.add_argument("--use_ema", action="store_true")
    parser.add_argument("--latent_dim", default=512, type=int)
    parser.add_argument("--cond_mask_prob", default=0.1, type=float)
    parser.add_argument("--context_len", default=0, type=int)

def add_diffusion_options(parser):
    parser.add_argument("--diffusion_steps", default=1000, type=int)
""",
    "utils/sampler_util.py": """
import torch

class ClassifierFreeSampleModel(torch.nn.Module):
    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, x, t, y):
        without = self.model(x, t, {**y, "uncond": True})
        return without + y["scale"].view(-1, 1, 1, 1) * (self.model(x, t, y) - without)
""",
    "utils/model_util.py": """
import torch
from model.rotation2xyz import Rotation2xyz

class Denoiser(torch.nn.Module):
    def __init__(self, width):
        super().__init__()
        self.first, self.output = torch.nn.Linear(263, width), torch.nn.Linear(width, 263)
        self.rot2xyz = Rotation2xyz(device="cpu", dataset="humanml")

    def forward(self, x, t, y):
        said = torch.tensor([0.0 if y.get("uncond") else len(text) % 7 for text in y["text"]])
        hidden = torch.tanh(self.first(x[:, :, 0].transpose(1, 2)) + said[:, None, None])
        return self.output(hidden).transpose(1, 2)[:, :, None] * y["mask"]

    def _apply(self, fn):  # as the public class does: it returns nothing
        super()._apply(fn)
        self.rot2xyz.smpl_model._apply(fn)

    def train(self, mode=True):
        super().train(mode)

class Diffusion:
    def __init__(self, steps):
        self.steps = steps

    def p_sample_loop(self, model, shape, clip_denoised=True, model_kwargs=None):
        assert not clip_denoised
        x = torch.randn(*shape, device=next(model.parameters()).device)
        for step in reversed(range(self.steps)):
            x = model(x, step, **model_kwargs) + (0.1 * torch.randn_like(x) if step else 0)
        return x

def create_model_and_diffusion(args, data):
    assert not hasattr(data.dataset, "num_actions")
    return Denoiser(args.latent_dim), Diffusion(args.diffusion_steps)

def load_model_wo_clip(model, state_dict):
    model.load_state_dict(state_dict)
""",
}

CLIP = """
import torch

class Encoder(torch.nn.Module):
    def __init__(self):
        super().__init__()
        self.words = torch.nn.Embedding(5000, 512)

    def encode_text(self, tokens):
        return self.words(tokens).mean(dim=1)

def load(version, device, jit):
    torch.manual_seed(0)
    return Encoder(), None

def tokenize(texts, context_length=77, truncate=False):
    rows = torch.zeros(len(texts), context_length, dtype=torch.long)
    for row, text in zip(rows, texts):
        for place, word in enumerate(text.split()[:context_length]):
            row[place] = sum(map(ord, word)) % 5000
    return rows

class model:
    convert_weights = staticmethod(lambda encoder: None)
"""

# Makes random weights from the checkout's own classes, as its training would save them; the output layer is small,
# so that bodies stay near the mean one.
RANDOM_WEIGHTS = """
import sys, types
from pathlib import Path
import torch
import prbench_guest_mdm as guest

public = guest.imported(Path(sys.argv[1]))
weights = Path(sys.argv[2])
torch.manual_seed(0)
args = guest.arguments(public.parser, weights.with_name("args.json"))
model, _ = public.models.create_model_and_diffusion(args, types.SimpleNamespace(dataset=None))
state = {name: value for name, value in model.state_dict().items() if not name.startswith("clip_model.")}
for name in list(state)[-2:]:
    state[name] = state[name] * 0.02
torch.save(state, weights)
"""
SETTINGS = {"latent_dim": 64, "layers": 2, "diffusion_steps": 5, "mask_frames": True}


def written(folder: Path, texts: dict[str, str]) -> Path:
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with statistics of synthetic people; a stand-in for `clip` is importable where there is none."""
    folder = tmp_path_factory.mktemp("guest")
    table = SequenceTable.open(write_synthetic_table(folder / "table"))
    chunk = next(iter(table.chunks(columns=["joints"])))
    rows = np.concatenate([encode(joints) for joints in np.split(chunk.joints, chunk.offsets[1:-1])])
    np.save(folder / "Mean.npy", rows.mean(axis=0))
    np.save(folder / "Std.npy", rows.std(axis=0))
    with pytest.MonkeyPatch.context() as patch:
        if PUBLIC and importlib.util.find_spec("clip") is None:
            written(folder / "more", {"clip.py": CLIP})
            patch.syspath_prepend(folder / "more")
        patch.setenv("PYTHONPATH", os.pathsep.join([str(folder / "more"), str(MODULE.parent)]))
        yield folder


@pytest.fixture(scope="module")
def checkout(root: Path) -> Path:
    return Path(PUBLIC) if PUBLIC else written(root / "checkout", MADE_UP)


@pytest.fixture(scope="module")
def weights(root: Path, checkout: Path) -> Path:
    written(root, {"args.json": json.dumps(SETTINGS)})
    path = root / "model000000000.pt"
    # In a process of its own, as training would be.
    subprocess.run([sys.executable, "-c", RANDOM_WEIGHTS, checkout, path], check=True)
    return path


@pytest.fixture
def options(root: Path, checkout: Path) -> dict[str, str]:
    return {"checkout": str(checkout), "statistics": str(root)}


@pytest.fixture(scope="class", autouse=True)
def case(root: Path, checkout: Path, weights: Path) -> None:
    """What --weights and --option are given."""
    TestConformance.weights = weights
    TestConformance.options = {"checkout": str(checkout), "statistics": str(root)}


class TestConformance(AdapterConformance):
    """Every check of `prbench adapters check`."""

    method = str(MODULE)


def batch(seeds: tuple[int, ...] = (1, 2)) -> ConditionBatch:
    return ConditionBatch(
        condition=Condition.TEXT,
        n_frames=np.array([40, 60])[: len(seeds)],
        fps=20.0,
        opaque_id=("a", "b")[: len(seeds)],
        noise_seed=seeds,
        text=("A person walks.", "A person waits for the bus.")[: len(seeds)],
    )


def test_averaged_weights_are_taken_where_training_says_so(
    weights: Path, options: dict[str, str], tmp_path: Path
) -> None:
    written(tmp_path, {"args.json": json.dumps({**SETTINGS, "use_ema": True})})
    averaged = tmp_path / weights.name
    torch.save({"model": {}, "model_avg": torch.load(weights, weights_only=True)}, averaged)
    first, second = (guest.load(path, options=options, device="cpu") for path in (weights, averaged))
    assert np.array_equal(first.generate(batch(), seed=0).joints, second.generate(batch(), seed=0).joints)


def test_a_row_has_the_same_noise_alone(weights: Path, options: dict[str, str]) -> None:
    method = guest.load(weights, options=options, device="cpu")
    together, alone = method.generate(batch(), seed=0), method.generate(batch((1,)), seed=0)
    assert np.allclose(together.joints[0, :40], alone.joints[0], atol=1e-4)


def test_what_executes_code_is_never_loaded(options: dict[str, str], tmp_path: Path) -> None:
    written(tmp_path, {"args.json": json.dumps(SETTINGS)})
    torch.save({"model": Path("x")}, tmp_path / "model1.pt")
    method = guest.load(tmp_path / "model1.pt", options=options, device="cpu")
    with pytest.raises(pickle.UnpicklingError, match="Weights only load failed"):
        method.generate(batch(), seed=0)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"checkout": "nowhere"}, "expected a checkout of motion-diffusion-model, found nowhere"),
        ({"guidance": "much"}, "option 'guidance': expected a number, found 'much'"),
        ({"check": "maybe"}, "option 'check': expected yes or no"),
        ({"chekout": "x"}, "unknown option 'chekout'; known options: checkout, statistics"),
    ],
)
def test_options_that_cannot_work_are_refused(
    weights: Path, options: dict[str, str], wrong: dict[str, str], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        guest.load(weights, options={**options, **wrong}, device="cpu")


def test_weights_need_the_options_of_their_training(options: dict[str, str], tmp_path: Path) -> None:
    written(tmp_path, {"model1.pt": ""})
    for given in (None, tmp_path, tmp_path / "model1.pt"):
        with pytest.raises(ValueError, match=r"expected --weights FILE, a model\*.pt with its args.json beside it"):
            guest.load(given, options=options, device="cpu")
