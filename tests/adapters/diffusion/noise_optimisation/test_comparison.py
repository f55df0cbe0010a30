from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from prbench.storage import read_json
from prbench_adapters.diffusion.noise_optimisation.compare import main
from prbench_adapters.diffusion.noise_optimisation.comparison import (
    SEQUENCE_COLUMNS,
    ModeResult,
    curve,
    prime_difference_interval,
    verdict,
    write_csv,
)
from prbench_adapters.diffusion.noise_optimisation.objective import Targets, prime_and_reach
from prbench_adapters.diffusion.noise_optimisation.optimise import optimise
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings, fast
from tests import fakes
from tests.adapters.diffusion import tiny
from tests.adapters.diffusion.noise_optimisation.linear import LinearDecoder


def _result(n=20, **changes):
    base = {name: np.linspace(0.1, 1.0, n) for name in SEQUENCE_COLUMNS[1:]}
    base |= {"prime_success": np.arange(n) % 2.0, "reach_success": np.ones(n)}
    return ModeResult(tuple(f"s{i}" for i in range(n)), **{**base, **changes})


RECORDINGS = [f"r{i}" for i in range(200)]


def test_sixteen_equal_sequences_are_too_few_to_show_equality():
    low, high = prime_difference_interval(np.zeros(16), RECORDINGS[:16])
    assert -low == pytest.approx(high) == pytest.approx(1.959964 / 18)
    assert verdict(_result(16), _result(16), RECORDINGS[:16])["prime_equal_within_10_points"] == "not shown"


def test_many_equal_sequences_show_it_and_a_real_difference_does_not():
    assert verdict(_result(200), _result(200), RECORDINGS)["prime_equal_within_10_points"] == "shown"
    worse = _result(200, prime_success=np.zeros(200))
    found = verdict(worse, _result(200), RECORDINGS)
    assert found["prime_difference"] == -0.5
    assert found["prime_equal_within_10_points"] == "not shown"


def test_of_one_recording_nothing_can_be_said():
    assert prime_difference_interval(np.zeros(40), ["r"] * 40) == (None, None)


def test_medians_decide_about_losses():
    found = verdict(_result(jerk=np.full(20, 0.2)), _result(jerk=np.full(20, 0.1)), RECORDINGS[:20])
    assert (found["goal_no_higher"], found["jerk_no_higher"]) == (True, False)


def test_modes_of_other_sequences_are_not_compared():
    other = dataclasses.replace(_result(), sequence_ids=tuple(f"t{i}" for i in range(20)))
    with pytest.raises(ValueError, match="same sequences"):
        verdict(_result(), other, RECORDINGS[:20])


def test_results_survive_the_file(tmp_path):
    write_csv(tmp_path / "fast.csv", SEQUENCE_COLUMNS, _result().rows())
    read = ModeResult.read(tmp_path / "fast.csv")
    assert read.sequence_ids == _result().sequence_ids
    for name in SEQUENCE_COLUMNS[1:]:
        np.testing.assert_array_equal(getattr(read, name), getattr(_result(), name))


def test_the_curve_counts_passes_and_keeps_finished_sequences_at_their_end():
    settings = OptimisationSettings(
        iterations=6, warmup=2, learning_rate=0.5, decorrelation_weight=0.0, stop_below=1e-6
    )
    start = torch.zeros(3, 8, 66)
    start[:2, -1, 63:66] = 10.0  # two of three are where they shall be
    zeros = torch.zeros(3, 22, 3)
    targets = Targets(initial_joints=zeros, previous_joints=zeros, goal_location=torch.ones(3, 3))
    found = optimise(
        LinearDecoder(), prime_and_reach(settings), targets, start, torch.full((3,), 8), range(3), settings
    )
    rows = np.array(curve(found))
    assert rows[:, 0].tolist() == [1, 2, 3, 4, 5, 6]
    assert (rows[:, 2] < 1e-6).all()


def test_the_program_runs_both_modes_once_and_writes_its_verdict(tmp_path, capsys):
    fakes.fake_dataset(tmp_path / "data", 24)
    weights = tiny.write(tmp_path / "pr.safetensors", goal="location", max_frames=120)
    command = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out"), "--weights", str(weights)]
    command += ["--sequences", "2", "--threads", "1", "--fast-option", "iterations=2"]
    command += ["--paper-option", "iterations=3", "--paper-option", "ddim-steps=3"]
    assert main([*command, "--modes", "fast"]) == 0
    assert not (tmp_path / "out" / "verdict.json").exists()
    assert main(command) == 0
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert (printed.count("fast: 2 sequences"), printed.count("paper: 2 sequences")) == (1, 1)
    found = read_json(tmp_path / "out" / "verdict.json")
    assert found["network_passes"] == {"fast": fast(8).ddim_steps * 3, "paper": 3 * (2 * 3 + 1)}
    assert (tmp_path / "out" / "curves.png").stat().st_size > 1000
    assert read_json(tmp_path / "out" / "paper.json")["made_of"]["settings"]["ddim_steps"] == 3


def test_the_program_names_what_is_wrong(tmp_path, capsys):
    fakes.fake_dataset(tmp_path / "data", 24)
    weights = tiny.write(tmp_path / "pr.safetensors", goal="location", max_frames=120)
    command = ["--data", str(tmp_path / "data"), "--out", str(tmp_path), "--weights", str(weights)]
    assert main([*command, "--modes", "slow"]) == 2
    assert main([*command, "--fast-option", "hand=both"]) == 2
    errors = capsys.readouterr().err
    assert "unknown mode 'slow'" in errors
    assert "option 'hand'" in errors
