"""The method ``gmd`` as the harness and a user meet it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prbench.contract import Condition
from prbench.harness.methods.loading import load_adapter
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.predictions import Predictions
from prbench_adapters.gmd.adapter import GMD, generate
from prbench_adapters.gmd.sampling import GMDSettings
from tests.adapters.gmd import tiny
from tests.fakes import fake_dataset, fake_sequence


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> Path:
    return tiny.write(tmp_path_factory.mktemp("weights") / "tiny.safetensors", max_frames=130)


def _load(weights: Path | None, device: str = "cpu", **options: str) -> GMD:
    adapter = load_adapter("gmd", weights, {key.replace("_", "-"): value for key, value in options.items()}, device)
    assert isinstance(adapter, GMD)
    return adapter


def test_options_reach_the_settings(weights):
    given = {"keyframes": "pose", "guidance": "1", "goal_scale": "30"}
    settings = _load(weights, steps="7", bones="initial", **given).settings
    assert settings == GMDSettings(1.0, 30.0, "pose", 7, "initial")


def test_smoothed_motions_average_neighbouring_frames_and_keep_their_keyframes():
    batch = tiny.batch((14, 9))
    plain, smooth = (generate(tiny.model(smoothed=each), batch, GMDSettings(steps=2)).joints for each in (False, True))
    for row, n in enumerate(batch.n_frames):
        pelvis, expected = smooth[row, :n, 0], plain[row, :n, 0].copy()
        expected[1:-1] = (plain[row, : n - 2, 0] + 2 * plain[row, 1 : n - 1, 0] + plain[row, 2:n, 0]) / 4
        assert np.allclose(pelvis, expected, atol=1e-5)


def test_a_run_predicts_every_sequence_and_ends_at_its_goal(weights, tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    table = fake_dataset(tmp_path / "table", 24)

    def ends(control: str | None) -> tuple[np.ndarray, np.ndarray]:
        out = tmp_path / f"run-{control}"
        run_method(
            RunRequest(
                method="gmd",
                data=(table.folder,),
                condition=Condition.GOAL_POSE,
                weights=weights,
                options={"steps": "3"},
                limit=3,
                control=control,
                out=out,
            )
        )
        predictions = Predictions.open(out / "synthetic-adt/predictions")
        ids = sorted(predictions.ids)
        found = [predictions.motions([name], 0).values[-1, 0, ::2] for name in ids]
        recorded = {row.sequence_id: row.joints[-1, 0, ::2] for row in map(fake_sequence, range(24))}
        return np.array(found), np.array([recorded[name] for name in ids])

    own, goals = ends(None)
    assert np.linalg.norm(own - goals, axis=1).max() < 0.1
    shuffled, _ = ends("shuffled-goal")
    assert np.linalg.norm(shuffled - goals, axis=1).mean() > 2 * np.linalg.norm(own - goals, axis=1).mean()
