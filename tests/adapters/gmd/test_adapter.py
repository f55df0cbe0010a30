"""The method ``gmd`` as the harness and a user meet it."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError, InputFileError
from prbench.harness.methods.loading import load_adapter
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.predictions import Predictions
from prbench_adapters.diffusion import method
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


def test_the_entry_point_loads_the_method_with_the_limits_of_its_weights(weights):
    adapter = _load(weights)
    assert adapter.conditions == {Condition.GOAL_POSE}
    assert adapter.max_frames == 130
    assert adapter.native_fps == 20.0
    assert adapter.settings == GMDSettings(guidance=2.5, goal_scale=100.0, keyframes="root")
    assert adapter.weights_for(Condition.GOAL_POSE) == weights


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


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"keyframe": "pose"}, r"unknown option 'keyframe'. Did you mean 'keyframes'\?"),
        ({"keyframes": "both"}, "option 'keyframes': expected root or pose, found 'both'"),
        ({"goal_scale": "-1"}, "option 'goal-scale': expected a number of 0 or more, found '-1'"),
        ({"steps": "51"}, "option 'steps': expected a whole number from 1 to 50, found '51'"),
    ],
)
def test_wrong_options_are_named(weights, option, message):
    with pytest.raises((ValueError, AdapterError), match=message):
        _load(weights, **option)


def test_without_weights_the_user_is_told_how_to_train_some(monkeypatch):
    monkeypatch.setattr(method, "bundled_names", lambda folder: [])
    with pytest.raises(AdapterError, match=r"gmd: no weights come with .*`prbench train --method gmd --config small"):
        _load(None)


def test_weights_of_another_kind_are_refused(tmp_path):
    path = tiny.write(tmp_path / "other.safetensors", metadata={"kind": "denoiser"})
    with pytest.raises(InputFileError, match=r"'kind': expected 'gmd', found 'denoiser'"):
        _load(path)


def test_a_network_that_does_not_fit_its_header_is_refused(tmp_path):
    configuration = '{"motion_widths":[16,16],"trajectory_widths":[8,8],"condition_width":8,"text_dimension":64}'
    path = tiny.write(tmp_path / "misfit.safetensors", metadata={"configuration": configuration})
    with pytest.raises(InputFileError, match=r"networks\.motion\..*: expected shape"):
        _load(path)


@pytest.mark.parametrize("goal", [np.nan, 50.0])
def test_a_goal_out_of_reach_is_refused(weights, goal):
    batch = tiny.batch()
    assert batch.goal_joints is not None
    joints = batch.goal_joints.copy()
    joints[1, :, 0] = goal
    with pytest.raises(AdapterError, match=r"adapter 'gmd', row 1 .*: expected a goal within 10 m of the first pose"):
        _load(weights).generate(dataclasses.replace(batch, goal_joints=joints), seed=0)


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
