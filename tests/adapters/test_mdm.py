from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.files.storage import file_digest
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import RunRecord
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


def test_conditions_other_than_text_are_refused(table, weights, tmp_path):
    for condition in (Condition.NONE, Condition.GOAL_LOCATION, Condition.GOAL_POSE):
        request = RunRequest(
            method="mdm", data=(table.folder,), condition=condition, weights=weights, out=tmp_path / "out"
        )
        with pytest.raises(AdapterError, match=r"does not take the condition .* Choose one of: text"):
            run_method(request)
