"""Weights files: exact, the same bytes every time, and refused in words where they are not what was asked for."""

from __future__ import annotations

import re
import shlex

import msgspec
import pytest
import torch
from torch import nn

from prbench.errors import InputFileError
from prbench.files.storage import file_digest, read_json
from prbench_adapters.training.configuration import resolve
from prbench_adapters.training.weights import read_weights, write_weights

HEADER = {"kind": "denoiser", "configuration": '{"width":3}', "representation": "humanml3d-263/continuous"}


class Network(msgspec.Struct, forbid_unknown_fields=True):
    width: int


@pytest.fixture
def tensors():
    draw = torch.Generator().manual_seed(0)
    return {
        "denoiser.weight": torch.randn(3, 4, generator=draw),
        "denoiser.bias": torch.randn(3, generator=draw),
        "statistics.std": torch.rand(4, generator=draw) * 1e-5,
    }


@pytest.fixture
def path(tensors, tmp_path):
    path = tmp_path / "w.safetensors"
    write_weights(path, tensors, HEADER, {"steps": 3})
    return path


def test_what_is_read_is_what_was_written(path, tensors):
    weights = read_weights(path, kind="denoiser")
    weights.require_representation("continuous")
    assert weights.tensors.keys() == tensors.keys()
    assert all(torch.equal(weights.tensors[name], tensor) for name, tensor in tensors.items())
    assert weights.kind == "denoiser"
    assert weights.configuration(Network) == Network(width=3)
    assert weights.digest == file_digest(path)


def test_half_precision_rounds_matrices_and_leaves_vectors_alone(tensors, tmp_path):
    path = tmp_path / "w.safetensors"
    write_weights(path, tensors, HEADER, {}, dtype="float16")
    read = read_weights(path).tensors
    assert {tensor.dtype for tensor in read.values()} == {torch.float32}
    assert torch.equal(read["denoiser.weight"], tensors["denoiser.weight"].half().float())
    assert not torch.equal(read["denoiser.weight"], tensors["denoiser.weight"])
    assert torch.equal(read["statistics.std"], tensors["statistics.std"]), "1e-5 would lose digits as a half"


def test_the_card_names_the_file_that_it_belongs_to(path):
    assert read_json(path.with_suffix(".json")) == {
        "steps": 3,
        "weights": "w.safetensors",
        "weights_sha256": file_digest(path),
    }


class Layered(msgspec.Struct, forbid_unknown_fields=True):
    widths: tuple[int, ...] = ()
    reference: bool = False
    encoder: str = "words"


@pytest.mark.parametrize(
    ("kept", "advice"),
    [
        (Layered(widths=(8, 16)), "--set 'model.widths=[8, 16]',"),
        (Layered(reference=True), "--set model.reference=true,"),
        (Layered(encoder="clip-vit-b32"), "--set model.encoder=clip-vit-b32,"),
    ],
)
def test_how_to_keep_a_setting_can_be_pasted_into_a_shell(kept, advice, tensors, tmp_path):
    header = {**HEADER, "configuration": msgspec.json.encode(kept).decode()}
    write_weights(tmp_path / "w.safetensors", tensors, header, {})
    with pytest.raises(InputFileError, match=re.escape(advice)) as refused:
        read_weights(tmp_path / "w.safetensors").require_same(Layered(), apart_from=())
    (setting,) = re.findall(r"--set (\S+=.*), or", str(refused.value))
    (unquoted,) = shlex.split(setting)
    key, _, value = unquoted.partition("=")
    tables = {"model": {}, "data": {}, "training": {"steps": 1}}
    resolved = resolve(tables, source=tmp_path, stage="pretrain", overrides=[(key, value)])
    assert msgspec.convert(resolved.model, Layered) == kept


def test_views_of_one_memory_are_written_apart(tmp_path):
    shared = torch.arange(12.0).reshape(3, 4)
    write_weights(tmp_path / "w.safetensors", {"a": shared, "b": shared.T}, HEADER, {})
    assert torch.equal(read_weights(tmp_path / "w.safetensors").tensors["b"], shared.T)


def test_a_module_is_filled_from_its_part(path, tensors):
    module = nn.Linear(4, 3)
    read_weights(path).load_into(module, "denoiser")
    assert torch.equal(module.weight, tensors["denoiser.weight"])


@pytest.mark.parametrize(
    ("module", "message"),
    [
        (nn.Linear(5, 3), r"denoiser\.weight: expected shape \(3, 5\), found shape \(3, 4\)"),
        (nn.Linear(4, 3, bias=False), r"denoiser\.bias: expected only tensors of the configured network"),
        (nn.Sequential(nn.Linear(4, 3)), r"denoiser\.0\.weight: expected a tensor of shape \(3, 4\), found none"),
    ],
)
def test_weights_that_do_not_fit_a_network_are_refused_by_name(module, message, path):
    with pytest.raises(InputFileError, match=message):
        read_weights(path).load_into(module, "denoiser")


def test_all_settings_that_differ_are_named_at_once(tensors, tmp_path):
    header = {**HEADER, "configuration": msgspec.json.encode(Layered(widths=(8,), reference=True)).decode()}
    write_weights(tmp_path / "w.safetensors", tensors, header, {})
    with pytest.raises(InputFileError, match=re.escape("Add --set 'model.widths=[8]' --set model.reference=true, or")):
        read_weights(tmp_path / "w.safetensors").require_same(Layered(), apart_from=())


def test_weights_of_another_kind_or_representation_are_refused(path):
    with pytest.raises(InputFileError, match="'kind': expected 't2m-evaluator', found 'denoiser'"):
        read_weights(path, kind="t2m-evaluator")
    with pytest.raises(InputFileError, match="expected 'humanml3d-263/reference', found 'humanml3d-263/continuous'"):
        read_weights(path).require_representation("reference")


def test_training_goes_on_from_the_same_network_alone(path):
    weights = read_weights(path)
    weights.require_same(Network(width=3), apart_from=())
    weights.require_same(Network(width=4), apart_from=("width",))
    with pytest.raises(InputFileError, match=r"configuration\.width: .*4.* found 3.*--set model\.width=3"):
        weights.require_same(Network(width=4), apart_from=())


@pytest.mark.parametrize(("value", "message"), [(float("nan"), "NaN or infinity"), (1e6, "does not fit float16")])
def test_weights_that_cannot_be_kept_are_not_written(value, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        write_weights(tmp_path / "w.safetensors", {"a": torch.full((2, 2), value)}, HEADER, {}, dtype="float16")
    assert not list(tmp_path.iterdir())
