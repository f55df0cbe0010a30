"""The importer of the public checkpoints, on stand-ins in the original's format."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import InputFileError, UsageError
from prbench.files.storage import file_digest
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.predictions import Predictions
from prbench_adapters.gmd.import_public import main
from prbench_adapters.gmd.model import GMDModel
from prbench_adapters.gmd.public_weights import PublicFiles, import_public
from prbench_adapters.gmd.sampling import GuidedNetwork
from tests.adapters.gmd import golden, tiny
from tests.fakes import fake_dataset, fake_sequence
from tests.text import tiny_clip

pytest.importorskip("transformers")
FIRST = "unet.downs.0.0.blocks.0.block1.0.weight"


@pytest.fixture
def files(tmp_path) -> PublicFiles:
    return tiny.write_released(tmp_path)


def _words(files: PublicFiles, out: Path) -> list[str]:
    return [
        *("--motion", str(files.motion), "--trajectory", str(files.trajectory)),
        *("--statistics", str(files.mean), str(files.std), "--projection", str(files.projection), "--out", str(out)),
    ]


def _assert_same_networks(model: GMDModel, expected: torch.nn.Module) -> None:
    found = model.networks.state_dict()
    assert set(found) == set(expected.state_dict())
    for name, tensor in expected.state_dict().items():
        assert torch.equal(found[name], tensor), name


def test_the_averaged_networks_arrive_with_their_statistics_projection_and_configuration(files, tmp_path):
    imported = import_public(files, tmp_path / "gmd.safetensors")
    model = GMDModel.load(tmp_path / "gmd.safetensors")
    _assert_same_networks(model, tiny.released_networks(0))
    expected = tiny.space()
    for part in ("mean", "std", "projection", "inverse"):
        assert torch.equal(getattr(model.space, part), getattr(expected, part))
    assert imported.copies == {"motion": "model_avg", "trajectory": "model_avg"}
    assert imported.parameters == sum(tensor.numel() for tensor in tiny.released_networks(0).parameters())
    found = model.configuration
    assert (found.motion_widths, found.trajectory_widths, found.condition_width) == ((16, 8, 8), (8, 16), 8)
    assert (found.diffusion_steps, found.padded_frames, found.padding_step, found.emphasis) == (1000, 224, 8, 10.0)
    assert (found.text_encoder, found.text_dimension) == ("clip-vit-b32", 512)
    assert (found.representation, found.uniform_skeleton, found.fps) == ("reference", True, 20.0)


@pytest.mark.parametrize("taken", ["model", "only"])
def test_a_checkpoint_of_one_copy_gives_that_one(files, tmp_path, taken):
    networks = tiny.released_networks(3)
    for path, network in ((files.motion, networks.motion), (files.trajectory, networks.trajectory)):
        state = tiny.state(network) | {"clip_model.visual.proj": torch.zeros(3)}
        torch.save({"model": state} if taken == "model" else state, path)
    imported = import_public(files, tmp_path / "gmd.safetensors")
    assert set(imported.copies.values()) == {taken}
    _assert_same_networks(GMDModel.load(tmp_path / "gmd.safetensors"), networks)


def test_the_golden_networks_come_through_the_importer(samples, files, tmp_path):
    """The original's own parameters, written as its checkpoints: the imported networks give the original's outputs."""
    cases = {name: golden.load(samples, f"gmd_{name}_step") for name in ("motion", "trajectory")}
    for name, arrays in cases.items():
        tensors = golden.checkpoint(arrays).tensors
        noisy = {key: tensor + 1 for key, tensor in tensors.items()}
        torch.save({"model": noisy, "model_avg": tensors}, getattr(files, name))
    for role, values in (("mean", "mean"), ("std", "std"), ("projection", "projection")):
        np.save(getattr(files, role), cases["motion"][values].astype(np.float32))
    import_public(files, tmp_path / "gmd.safetensors")
    model = GMDModel.load(tmp_path / "gmd.safetensors")
    for name, arrays in cases.items():
        state, text = golden.features(arrays["x_t"]), torch.from_numpy(arrays["text"])
        n_frames = torch.full((len(text),), state.shape[1])
        window = model.configuration.window(state.shape[1])
        for output, scale in (("network_output", 1.0), ("network_output_guided", 2.5)):
            guided = GuidedNetwork(getattr(model.networks, name), text, n_frames, window=window, scale=scale)
            found = guided(state, int(arrays["t"][0]))
            assert (found - golden.features(arrays[output])).abs().max() < 1e-5


def test_the_card_says_where_the_weights_come_from_and_names_no_folder(files, tmp_path):
    import_public(files, tmp_path / "gmd.safetensors")
    text = (tmp_path / "gmd.json").read_text(encoding="utf-8")
    card = json.loads(text)
    assert str(tmp_path) not in text
    assert (card["method"], card["stage"]) == ("gmd", "imported")
    assert "MIT" in card["licence"]
    assert "korrawe/guided-motion-diffusion" in card["origin"]
    expected = {"name": files.motion.name, "sha256": file_digest(files.motion), "copy": "model_avg"}
    assert card["files"]["motion"] == expected
    assert card["files"]["projection"]["as_released"] is False
    assert card["weights_sha256"] == file_digest(tmp_path / "gmd.safetensors")


class _RunsCode:
    """Unpickling this would write a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.path),)


def test_code_in_a_checkpoint_is_not_run_and_an_old_pytorch_that_would_is_refused(files, tmp_path, monkeypatch):
    torch.save({"model_avg": {"a": _RunsCode(tmp_path / "ran")}}, files.motion)
    message = r"model000500000\.pt: expected a checkpoint of numbers alone, found one that asks for '\w+\.mkdir'.*"
    with pytest.raises(InputFileError, match=message + r"keep its tensors alone.*torch\.save"):
        import_public(files, tmp_path / "gmd.safetensors")
    assert not (tmp_path / "ran").exists()
    assert not list(tmp_path.glob("gmd*"))
    monkeypatch.setattr(torch, "__version__", "2.5.1+cpu")
    with pytest.raises(UsageError, match=r"needs PyTorch 2\.6 or later, found 2\.5\.1\+cpu \(CVE-2025-32434\)"):
        import_public(files, tmp_path / "gmd.safetensors")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({FIRST: None}, rf"'{FIRST}': expected a tensor of shape \(16, 263, 5\), found none of this name"),
        ({FIRST: torch.zeros(16, 263, 3)}, rf"'{FIRST}': expected shape \(16, 263, 5\), found shape \(16, 263, 3\)"),
        ({FIRST: torch.full((16, 263, 5), torch.nan)}, rf"'{FIRST}': expected finite numbers, found torch.float32"),
        ({"unet.mid_attn.fn.norm.g": torch.ones(8)}, r"'unet\.mid_attn.*': expected only parameters of the network"),
        (
            {"embed_text.weight": torch.zeros(8)},
            r"'embed_text\.weight': expected shape \(any, any\), found shape \(8,\)",
        ),
        ({"unet.downs.0.1.blocks.0.block1.0.bias": torch.zeros(12)}, r"sizes: expected networks of GMD, found others"),
    ],
)
def test_what_is_wrong_in_a_checkpoint_is_named(files, tmp_path, change, message):
    content = torch.load(files.motion, weights_only=True)
    for name, tensor in change.items():
        content["model_avg"].pop(name, None)
        content["model_avg"] |= {} if tensor is None else {name: tensor}
    torch.save(content, files.motion)
    with pytest.raises(InputFileError, match=r"model000500000\.pt, " + message):
        import_public(files, tmp_path / "gmd.safetensors")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "expected a checkpoint .*found no such file"),
        ("trajectory", r"expected shape \(8, 263, 5\), found shape \(8, 4, 5\)\. Give the motion"),
        (b"<html>not found</html>", r"expected a checkpoint of torch\.save .*found another format.*unpack it first"),
        ({"state_dict": torch.nn.Linear(1, 1)}, "found one that asks for 'torch.nn.modules.linear.Linear'"),
        ({"epoch": 3}, "'epoch': expected a tensor, found a int"),
        ([1, 2], "expected tensors by name, found a list"),
        ({"weight": torch.zeros(2)}, r"'embed_text\.weight': expected a tensor of shape \(any, any\), found none"),
    ],
)
def test_other_files_are_refused(files, tmp_path, content, message):
    files.motion.unlink()
    if content == "trajectory":
        files = dataclasses.replace(files, motion=files.trajectory)
    elif isinstance(content, bytes):
        files.motion.write_bytes(content)
    elif content is not None:
        torch.save(content, files.motion)
    with pytest.raises(InputFileError, match=message):
        import_public(files, tmp_path / "gmd.safetensors")


@pytest.mark.parametrize(
    ("role", "values", "message"),
    [
        (
            "std",
            np.linspace(-0.1, 0.1, 263),
            r"column 0: expected a positive deviation, found -0\.1\. Give --statistics",
        ),
        ("std", np.full(263, 0.02), r"columns 1 and 2: .*found 0\.020 m, as of its steps.*relative features"),
        ("std", np.ones(4), r"expected an array of shape \(263,\), found shape \(4,\)"),
        ("mean", np.full(263, np.nan), "expected finite numbers, found float64"),
        ("mean", np.array([{}] * 263), r"expected numbers or text, found Python objects"),
        (
            "projection",
            np.linalg.inv(tiny.space().projection.double()),
            "expected an emphasis projection.*inv_rand_proj",
        ),
        ("projection", np.ones((263, 263)), "expected an emphasis projection that can be inverted"),
    ],
)
def test_wrong_statistics_and_projections_are_refused(files, tmp_path, role, values, message):
    np.save(getattr(files, role), values, allow_pickle=True)
    with pytest.raises(InputFileError, match=message):
        import_public(files, tmp_path / "gmd.safetensors")


def test_the_command_reports_what_it_took_and_what_comes_next(files, tmp_path, capsys):
    out = tmp_path / "new" / "gmd-public.safetensors"
    assert main(_words(files, out)) == 0
    shown = capsys.readouterr().out
    assert "motion network: 16, 8, 8 channels, copy 'model_avg'" in shown
    assert "rand_proj.npy: not the file of the public repository" in shown
    assert f"prbench run --method gmd --condition goal-pose --weights {out}" in shown
    assert sorted(path.name for path in out.parent.iterdir()) == ["gmd-public.json", "gmd-public.safetensors"]


def test_the_command_exits_with_the_code_of_the_error_and_writes_nothing(files, tmp_path, capsys):
    files.projection.unlink()
    assert main(_words(files, tmp_path / "gmd.safetensors")) == InputFileError.exit_code
    assert "rand_proj.npy: expected this file, found no such file" in capsys.readouterr().err
    assert main(_words(files, tmp_path / "gmd.pt")) == UsageError.exit_code
    assert not list(tmp_path.glob("gmd*"))


def test_help_shows_an_example_and_needs_no_torch():
    code = "import sys\nfrom prbench_adapters.gmd.import_public import main\n"
    code += "try:\n    main(['--help'])\nfinally:\n    print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0
    assert "--projection dataset/rand_proj.npy --out gmd-public.safetensors" in done.stdout
    assert done.stdout.strip().endswith("False")


def test_imported_weights_run_and_end_at_their_goals(files, tmp_path, monkeypatch):
    """The path of Table 2's row GMD †, with CLIP's files where the environment says."""
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PRBENCH_CLIP", str(tiny_clip.write(tmp_path / "clip")))
    weights = tmp_path / "gmd-public.safetensors"
    import_public(files, weights)
    table = fake_dataset(tmp_path / "table", 24)
    request = RunRequest(
        method="gmd",
        data=(table.folder,),
        condition=Condition.GOAL_POSE,
        weights=weights,
        options={"steps": "3"},
        limit=2,
        out=tmp_path / "run",
    )
    run_method(request)
    predictions = Predictions.open(tmp_path / "run" / "synthetic-adt/predictions")
    recorded = {row.sequence_id: row.joints[-1, 0, ::2] for row in map(fake_sequence, range(24))}
    assert len(list(predictions.ids)) == 2
    for name in predictions.ids:
        found = predictions.motions([name], 0).values[-1, 0, ::2]
        assert np.linalg.norm(found - recorded[name]) < 0.01
