"""Features and state changes as the original program computes them (``metrics/PROVENANCE.md``)."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from prbench_adapters.kinematics import matrices_of, rows_of
from prbench_adapters.wandr.network import BodyState, heading_of, intentions, yaw_rotation

TOLERANCE = 1e-5


@pytest.fixture(scope="module")
def golden(samples) -> dict[str, torch.Tensor]:
    with np.load(samples / "metrics" / "networks" / "wandr_step.npz") as arrays:
        return {name: torch.from_numpy(arrays[name]) for name in arrays}


def _close(found: torch.Tensor, expected: torch.Tensor) -> None:
    error = (found - expected).abs() / expected.abs().clamp_min(1.0)
    assert error.max() < TOLERANCE, f"{error.max():.1e}"


def test_yaw_and_heading(golden):
    root = matrices_of(golden["root6d"])
    yaw = yaw_rotation(root)
    _close(yaw, golden["yaw_rotation"])
    _close(heading_of(yaw), golden["heading"])
    _close(rows_of(yaw.mT @ root), golden["orientation_without_yaw"])


def test_intentions(golden):
    found = intentions(
        yaw_rotation(matrices_of(golden["root6d"])),
        wrist=golden["wrist"],
        pelvis=golden["pelvis"],
        goal=golden["goal"],
        frames_left=golden["frames_left"],
        fps=30.0,
    )
    wrist, pelvis, heading = found.split(3, -1)
    _close(wrist, golden["wrist_intention"])
    _close(pelvis, golden["pelvis_intention"])
    _close(heading, golden["heading_intention"])


def test_next_state_and_the_change_between_both(golden):
    state = BodyState(golden["translation"], matrices_of(golden["rotations6d"]))
    turns = golden["delta_rotations6d"].flatten(1)
    following = state.changed(torch.cat((golden["delta_translation"], turns), -1))
    _close(following.pelvis, golden["next_translation"])
    _close(rows_of(following.rotations), golden["next_rotations6d"])
    recovered = state.delta_to(BodyState(golden["next_translation"], matrices_of(golden["next_rotations6d"])))
    _close(recovered[:, :3], golden["delta_translation"])
    _close(recovered[:, 3:], golden["delta_from_pair"].flatten(1))


def test_the_example_of_the_page():
    found = intentions(
        torch.eye(3)[None],
        wrist=torch.tensor([[0.3, -0.2, 1.0]]),
        pelvis=torch.tensor([[0.0, 0.0, 0.9]]),
        goal=torch.tensor([[1.3, -1.2, 1.0]]),
        frames_left=torch.tensor([[30.0]]),
        fps=30.0,
    )
    expected = [0.99999, -0.99999, 0, 1.2178, -1.1242, 0, 0.7348, 0.3217, 0]
    assert found[0].tolist() == pytest.approx(expected, abs=6e-5)
