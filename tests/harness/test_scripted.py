"""Cheats earn what ``docs/audit.md`` says, and nobody's motion but their own first pose is behind it."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import WRISTS, Joint, bone_lengths
from prbench.harness.controls import CONTROLS
from prbench.harness.methods.installed import CHEATS, METHOD_CONTROLS
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions
from prbench.harness.scripted import SCRIPTED_CONTROLS, ScriptedStart
from prbench.metrics import MotionBatch, ScoringTargets, score
from prbench.protocol.manifests import load_protocol
from tests.fakes import STANDING
from tests.harness.test_controls import TILT, goals_around, ray_distance
from tests.harness.test_run import request

FPS = 20.0
N_FRAMES = 101
GOALS = goals_around()
GOALS = GOALS[np.hypot(GOALS[:, 0], GOALS[:, 2]) > 0.5]


def motions(name: str, *, n_frames: int = N_FRAMES, fps: float = FPS) -> np.ndarray:
    start = ScriptedStart(np.tile(STANDING, (len(GOALS), 1, 1)), GOALS, np.full(len(GOALS), TILT))
    return SCRIPTED_CONTROLS[name](start, np.full(len(GOALS), n_frames), fps).astype(np.float32)


def earned(name: str, fps: float = FPS) -> dict[str, float]:
    made = motions(name, n_frames=round(5 * fps) + 1, fps=fps)
    still = np.repeat(STANDING[None, None], made.shape[1], axis=1).repeat(len(GOALS), axis=0)
    n_frames = np.full(len(GOALS), made.shape[1])
    targets = ScoringTargets(GOALS, np.full(len(GOALS), 2.0), np.full(len(GOALS), -1), np.full(len(GOALS), TILT), fps)
    predicted = MotionBatch.from_padded(made, n_frames)
    values = score(predicted, MotionBatch.from_padded(still, n_frames), targets, load_protocol().metrics)
    return {metric: float(found.value.mean()) for metric, found in values.items()}


def test_staring_is_motionless_and_on_the_goal_and_primes_nothing():
    joints = motions("stare")
    assert np.ptp(joints, axis=1).max() == 0.0
    assert ray_distance(joints[:, 0], GOALS).max() < 0.03
    assert earned("stare")["prime_success"] == 0.0


@pytest.mark.parametrize("fps", [20.0, 25.0, 30.0])
def test_a_tenth_of_a_millimetre_of_tremor_primes_every_goal_by_the_equation_and_none_at_its_onset(fps):
    assert np.ptp(motions("tremor", fps=fps), axis=1).max() <= 1.01e-4
    found = earned("tremor", fps)
    assert found["prime_success"] == 1.0
    assert found["prime_success_onset"] == 0.0
    assert found["reach_success"] < 0.1


def test_a_late_look_primes_and_never_reaches():
    joints = motions("stare-late")
    assert np.allclose(joints[:, :30], STANDING, atol=1e-6)
    assert np.ptp(joints[:, 41:], axis=1).max() == 0.0
    found = earned("stare-late")
    assert found["prime_success"] == 1.0
    assert found["reach_success"] < 0.1


def test_a_jump_primes_and_reaches_in_one_frame():
    joints = motions("teleport")
    assert np.allclose(joints[:, :40], STANDING, atol=1e-6)
    assert np.ptp(joints[:, 40:], axis=1).max() == 0.0
    assert np.linalg.norm(joints[:, -1][:, WRISTS] - GOALS[:, None], axis=-1).min(axis=1).max() < 1e-5
    steps = np.linalg.norm(np.diff(joints[:, :, Joint.PELVIS], axis=1), axis=-1) * FPS
    assert (steps.max(axis=1)[np.hypot(GOALS[:, 0], GOALS[:, 2]) > 1.5] > 20.0).all()  # metres per second
    found = earned("teleport")
    assert found["prime_success"] == found["reach_success"] == 1.0


def test_a_motion_that_ends_before_two_seconds_jumps_in_its_last_frame():
    joints = motions("teleport", n_frames=21)
    assert np.allclose(joints[:, :20], STANDING, atol=1e-6)
    assert np.linalg.norm(joints[:, -1][:, WRISTS] - GOALS[:, None], axis=-1).min(axis=1).max() < 1e-5


def test_a_floating_body_starts_on_the_floor_reaches_and_never_skates():
    joints = motions("float")
    assert np.allclose(joints[:, 0], STANDING, atol=1e-6)
    assert joints[:, 10:, [10, 11], 1].min() > 0.05
    found = earned("float")
    assert found["prime_success"] == found["reach_success"] == 1.0
    assert found["foot_skating"] == found["contact_share"] * 0.0


@pytest.mark.parametrize("name", ["stare", "stare-late", "tremor"])
def test_cheats_that_only_look_keep_their_bones(name):
    lengths = bone_lengths(motions(name).astype(np.float64))
    assert np.allclose(lengths, bone_lengths(STANDING), atol=2e-4)


@pytest.mark.parametrize("name", CHEATS)
def test_every_cheat_can_be_run_and_is_the_same_in_any_batch(table, tmp_path, name):
    assert name in METHOD_CONTROLS
    run_method(request(table, tmp_path / "one", name, batch_size=1))
    run_method(request(table, tmp_path / "all", name, batch_size=64, seed=5))
    ids = [row for chunk in table.chunks(split="test", columns=[]) for row in chunk.sequence_ids]
    one, together = (
        Predictions.open(tmp_path / run / "synthetic-adt/predictions").motions(ids, 0).values for run in ("one", "all")
    )
    assert np.array_equal(one, together)


def test_lists_name_every_control_and_say_what_it_does():
    assert len({control.summary for control in CONTROLS}) == len(CONTROLS)
    for control in CONTROLS:
        assert control.summary.startswith("cheat: ") == (control.name in CHEATS)
