"""``prbench analyse distributions``: features of motions that are made by hand, the distance, and what is printed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import ks_2samp

from prbench.cli import main
from prbench.geometry.skeleton import Joint
from prbench.harness.diversity import MotionsToGoal
from prbench.protocol.manifests import load_protocol
from prbench_benchmarks.prime_and_reach.distributions import FEATURES, features, largest_difference
from tests.benchmarks.prime_and_reach.test_analyse_commands import GENTLE, made_run
from tests.cli.reports import reported
from tests.fakes import STANDING, fake_dataset
from tests.method_fixtures import adapter_source, install, own_cache

__all__ = ["install", "own_cache"]

FPS = 20.0
FRAMES = 41
LEFT_LEG, RIGHT_LEG = ([Joint[f"{side}_{name}"] for name in ("ANKLE", "FOOT")] for side in ("LEFT", "RIGHT"))


def measured(joints: np.ndarray, prime_time: float = 1.0) -> dict[str, float]:
    """Features of one motion towards a goal 1 m in front of the right wrist; another one stands still beside it."""
    still = np.repeat(STANDING[None], FRAMES, axis=0)
    goal = STANDING[Joint.RIGHT_WRIST] + [0.0, 0.0, 1.0]
    motions = MotionsToGoal(joints=np.stack([still, joints]), goal=goal, head_tilt_deg=0.0, fps=FPS)
    return {name: values[1] for name, values in features(motions, prime_time, load_protocol().metrics).items()}


def turned(degrees: np.ndarray) -> np.ndarray:
    """The standing body, turned about the vertical in each frame."""
    angle = np.deg2rad(degrees)[:, None]
    x, y, z = np.repeat(STANDING[None], len(degrees), axis=0).transpose(2, 0, 1)
    return np.stack([x * np.cos(angle) + z * np.sin(angle), y, z * np.cos(angle) - x * np.sin(angle)], axis=-1)


def test_a_turning_head_has_its_yaw_rate_and_a_bent_neck_its_pitch():
    found = measured(turned(np.interp(np.arange(FRAMES), [10, 20], [0, 45])))
    assert found["head_yaw_rate"] == pytest.approx(90)
    joints = turned(np.zeros(FRAMES))
    joints[20, Joint.HEAD] += [0, 0, 0.05]
    bend = np.rad2deg(np.arctan2(*(joints[20, Joint.HEAD] - joints[20, Joint.NECK])[[2, 1]]))
    assert measured(joints)["head_pitch"] == pytest.approx(-bend)
    assert abs(measured(joints, prime_time=1.5)["head_pitch"]) < bend - 5


def test_a_reach_has_speed_arrival_and_the_time_since_the_look():
    joints = turned(np.zeros(FRAMES))
    joints[:, Joint.RIGHT_WRIST, 2] += np.interp(np.arange(FRAMES), [20, 30], [0, 0.6])
    found = measured(joints)
    assert found["wrist_speed"] == pytest.approx(1.2)
    # One frame lies within the last 0.1 m, and ten are behind it.
    assert found["wrist_arrival"] == pytest.approx(0.55)
    joints[:, Joint.NECK, 2] += 0.2
    trunk = joints[0, Joint.NECK] - joints[0, Joint.PELVIS]
    assert measured(joints)["trunk_bend"] == pytest.approx(np.rad2deg(np.arctan2(trunk[2], trunk[1])))


def test_steps_have_lift_time_and_length_and_a_detour_its_ratio():
    joints = turned(np.zeros(FRAMES))
    for leg, first in ((LEFT_LEG, 5), (RIGHT_LEG, 20)):
        share = np.clip((np.arange(FRAMES) - first) / 8, 0, 1)
        joints[:, leg, 2] += 0.6 * share[:, None]
        joints[:, leg, 1] += 0.08 * np.sin(np.pi * share)[:, None]
    others = [joint for joint in Joint if joint not in (*LEFT_LEG, *RIGHT_LEG)]
    joints[:, others, 2] += np.interp(np.arange(FRAMES), [0, 30, 40], [0, 0.75, 0.5])[:, None]
    found = measured(joints)
    assert found["swing_time"] == pytest.approx(8 / FPS)
    assert found["toe_lift"] == pytest.approx(0.08)
    assert found["step_length"] == pytest.approx(0.6)
    assert found["path_ratio"] == pytest.approx(1.0 / 0.75)
    assert found["pelvis_speed"] == pytest.approx(0.5)
    standing = measured(turned(np.zeros(FRAMES)))
    assert {name for name, value in standing.items() if np.isnan(value)} == {
        "toe_lift", "swing_time", "step_length", "path_ratio",
    }  # fmt: skip


def test_jitter_is_the_root_mean_square_of_the_third_difference():
    joints = turned(np.zeros(FRAMES))
    joints[..., 0] += 0.001 * np.arange(FRAMES)[:, None] ** 3
    assert measured(joints)["jitter"] == pytest.approx(0.006 * FPS**3)


@pytest.mark.parametrize("samples", [1, 3])
def test_the_distance_is_that_of_kolmogorov_and_smirnov(samples):
    rng = np.random.default_rng(4)
    people = np.round(rng.normal(size=80), 1)  # with ties
    for shift in (0.4, -0.4, 0.0):
        method = np.round(rng.normal(shift, 1.5, size=(80, samples)), 1)
        part = largest_difference(people, method)
        assert part.mean() == pytest.approx(ks_2samp(people, method.ravel()).statistic)
    assert not largest_difference(people, people[:, None]).any()


def test_recorded_motion_passes_and_noise_does_not(tmp_path, install, capsys):
    table = fake_dataset(tmp_path / "table", 60)
    data = ["--data", str(table.folder)]
    run = made_run(table, tmp_path / "people", method="ground-truth", condition=None, samples=1)
    install("made", adapter_source(body=GENTLE))
    noisy = made_run(table, tmp_path / "noisy")
    people, noise = reported(["analyse", "distributions", run, noisy, *data], capsys).tables
    for row in people.blocks[0].rows:
        cells = {cell.metric: cell for cell in row.cells}
        if row.text["passes"] == "yes":
            assert cells["ks"].value == 0
            assert cells["ks"].low == 0
            assert "spread_ratio" not in cells or cells["spread_ratio"].value == pytest.approx(1.0)
    assert "of 12 features as recorded people's" in people.title
    jitter = noise.blocks[0].rows[list(FEATURES).index("jitter")]
    assert jitter.text["passes"] == "no"
    assert next(cell.value for cell in jitter.cells if cell.metric == "ks") == 1
    for part in (tmp_path / "people/synthetic-adt/predictions").iterdir():
        part.unlink()
    assert main(["analyse", "distributions", run, *data]) != 0
    assert "expected the predictions of a run, found none" in capsys.readouterr().err
