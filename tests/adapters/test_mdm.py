from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.files.storage import file_digest
from prbench.harness.methods.loading import load_adapter
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import RunRecord
from prbench_adapters.mdm import DEFAULT_WEIGHTS, MDM
from tests.adapters.diffusion import tiny
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    return tiny.write(tmp_path_factory.mktemp("weights") / "tiny-text.safetensors", max_frames=80)


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("data") / "table", 60)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))


def _load(weights: Path | None, device: str = "cpu", **options: str) -> MDM:
    adapter = load_adapter("mdm", weights, options, device)
    assert isinstance(adapter, MDM)
    return adapter


def test_the_entry_point_loads_the_method_with_the_limits_of_its_weights(weights):
    adapter = _load(weights)
    assert adapter.conditions == {Condition.TEXT}
    assert adapter.max_frames == 80
    assert adapter.native_fps == 20.0
    assert adapter.settings.guidance == 2.5
    assert adapter.weights_for(Condition.TEXT) == weights


def test_motions_have_the_lengths_asked_for_and_no_nan(weights):
    motions = _load(weights, sampler="ddim", steps="2").generate(tiny.text_batch([5, 30, 17]), seed=0)
    assert motions.joints.shape == (3, 30, 22, 3)
    assert np.isfinite(motions.ragged()).all()
    assert motions.cost is not None
    assert motions.cost.network_passes == 3 * 2 * 2


def _predicted(table, weights: Path, out: Path, control: str | None) -> np.ndarray:
    run_method(
        RunRequest(
            method="mdm",
            data=(table.folder,),
            condition=Condition.TEXT,
            weights=weights,
            options={"sampler": "ddim", "steps": "2"},
            control=control,
            out=out,
        )
    )
    predictions = Predictions.open(out / "synthetic-adt/predictions")
    return predictions.motions(sorted(predictions.ids), 0).values


def test_another_goal_changes_nothing(table, weights, tmp_path):
    own = _predicted(table, weights, tmp_path / "own", None)
    shuffled = _predicted(table, weights, tmp_path / "shuffled", "shuffled-goal")
    assert np.array_equal(own, shuffled)
    record = RunRecord.read(tmp_path / "own")
    assert record.method.weights == "tiny-text.safetensors"
    assert record.method.weights_digest == file_digest(weights)


@pytest.mark.parametrize("condition", [Condition.NONE, Condition.GOAL_LOCATION, Condition.GOAL_POSE])
def test_conditions_other_than_text_are_refused(table, weights, tmp_path, condition):
    request = RunRequest(method="mdm", data=(table.folder,), condition=condition, weights=weights, out=tmp_path / "out")
    with pytest.raises(AdapterError, match=r"does not take the condition .* Choose one of: text"):
        run_method(request)


def test_weights_of_a_goal_model_are_refused(tmp_path):
    path = tiny.write(tmp_path / "goal.safetensors", goal="location")
    with pytest.raises(
        AdapterError, match=r"goal\.safetensors: expected a model of goal 'none', found one of goal 'loc"
    ):
        _load(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"guidence": "2"}, "unknown option 'guidence'. Did you mean 'guidance'"),
        ({"steps": "9"}, "option 'steps': expected a whole number from 1 to 8, found '9'"),
        ({"sampler": "heun"}, "option 'sampler'"),
    ],
)
def test_bad_options_are_refused(weights, options, message):
    with pytest.raises(AdapterError, match=message):
        _load(weights, **options)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_said_so(weights):
    with pytest.raises(AdapterError, match="there is no usable GPU here"):
        _load(weights, "cuda")


def test_importing_the_module_is_cheap():
    import subprocess

    code = "import sys, prbench_adapters.mdm; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_bundled_weights_run_by_name_if_they_are_shipped():
    from prbench_adapters.diffusion.method import bundled_names

    if DEFAULT_WEIGHTS not in bundled_names():
        pytest.skip("this checkout has no bundled weights")
    adapter = _load(Path(DEFAULT_WEIGHTS), sampler="ddim", steps="2")
    assert adapter.max_frames == 241
    assert np.isfinite(adapter.generate(tiny.text_batch([20]), seed=0).joints).all()
