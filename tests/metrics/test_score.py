"""All metrics at once: laws that hold for every one of them, the length contract, and what a metric says of itself."""

from __future__ import annotations

import sys

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prbench.harness.intervals import metric_interval
from prbench.metrics import (
    MAIN_METRICS,
    METRICS,
    METRICS_OF_MOTIONS,
    STUDY_METRICS,
    GazeRays,
    MetricInfo,
    MotionBatch,
    ScoringTargets,
    exported_unit,
    printed_unit,
    score,
)
from prbench.metrics.registry import find_families
from prbench.protocol.manifests import Limit
from tests.metrics.motions import CONSTANTS, batch, random_problem, standing, targets, turned


def eased(limits: dict[str, Limit]) -> dict[str, Limit]:
    """Return limits that some random motions keep and some break."""
    values = {
        "floating": 0.15,
        "penetration": 0.15,
        "bone_change": 2.5,
        "slow_slides": 0.95,
        "jerk": 90.0,
        "speed": 1.9,
    }
    values |= {"lower_toe": 0.2, "slides": 1.0, "support": 0.0, "drag": 1.0, "unsupported_speed": 1.7, "step_rate": 5.0}
    values |= {
        "flight": 0.8,
        "swing_time": 0.0,
        "foot_roll": 0.0,
        "neck": 160.0,
        "twisting": 900.0,
        "nodding": 900.0,
        "overhang": 1.0,
    }
    values |= {
        "hip": 170.0,
        "toe_out": 170.0,
        "spine": 170.0,
        "ankle": 165.0,
        "head_under_goal": 0.5,
        "given_bones": 2.5,
    }
    values |= {"given_start": 9.0, "smallest_body": 0.5, "largest_body": 4.0, "shortest_arm": 0.1, "longest_arm": 1.0}
    return {name: msgspec.structs.replace(limit, value=values.get(name, limit.value)) for name, limit in limits.items()}


EASIER = msgspec.structs.replace(
    CONSTANTS,
    prime_distance=0.4,
    prime_angle_deg=35.0,
    reach_distance=0.2,
    location_error_distance=0.15,
    plausible=eased(CONSTANTS.plausible),
    plausible_3=eased(CONSTANTS.plausible_3),
)
LENGTHS = (2, 3, 4, 5, 17, 60, 200, 31, 2, 120, 44, 7)


def values(*problem, **options) -> dict[str, list[float]]:
    return {metric: found.value.tolist() for metric, found in score(*problem, EASIER, **options).items()}


def reordered(motion: MotionBatch, order) -> MotionBatch:
    return batch(*(motion.values[motion.offsets[i] : motion.offsets[i + 1]] for i in order))


def reordered_targets(where: ScoringTargets, order) -> ScoringTargets:
    return targets(
        len(order),
        goal=where.goal_location[order],
        prime_time=where.prime_time[order],
        hand=where.hand[order],
        tilt=where.head_tilt_deg[order],
    )


def test_the_metrics_stand_in_printed_order() -> None:
    assert len({info.position for info in METRICS}) == len(METRICS), "two metrics share a place in printed tables"
    main = [info.id for info in METRICS if info.main]
    study = ["prime_success", "reach_success", "goal_mpjpe", "location_error", "mpjpe", "foot_skating"]
    assert [info.id for info in STUDY_METRICS] == study, "the columns of the study's Table 2, in its order"
    assert main == [*study, "plausible", "plausible_3"]
    assert [info.id for info in MAIN_METRICS] == main
    assert [info.id for info in MAIN_METRICS if info.ranked] == study, "a body that stands still is plausible"
    beside = """
        prime_success_arrival
        prime_success_onset prime_success_angle first_frame_error first_step floating penetration slow_slides
        largest_jerk largest_speed reach_success_final reach_wrist location_error_horizontal contact_share
        bone_length_change prime_success_gaze prime_success_gaze_arrival scene_penetration scene_depth
    """
    assert {info.id for info in METRICS if not info.main} == set(beside.split())
    assert list(score(*random_problem(0, [5]), CONSTANTS)) == [info.id for info in METRICS_OF_MOTIONS]
    compared = "goal_mpjpe mpjpe location_error location_error_horizontal reach_wrist first_frame_error"
    assert {metric.id for metric in METRICS if metric.compares_with_recorded} == set(compared.split())
    assert [metric.id for metric in METRICS if metric.carries_copy_remark] == ["mpjpe"]
    assert [metric.id for metric in METRICS if metric.irrelevant_if_motionless] == ["foot_skating"]


def test_the_laws_are_tried_where_every_rate_takes_both_values() -> None:
    found = [values(*random_problem(seed, LENGTHS * 3)) for seed in range(4)]
    for info in (info for info in METRICS if info.unit == "rate" and info.id in found[0]):
        assert {value for each in found for value in each[info.id]} == {0.0, 1.0}, info.id


def test_recorded_motion_has_no_error_at_all() -> None:
    _, recorded, where = random_problem(1, LENGTHS, dtype=np.float32)
    found = values(recorded, recorded, where)
    for metric in ("goal_mpjpe", "mpjpe", "location_error", "location_error_horizontal", "first_frame_error"):
        assert found[metric] == [0.0] * len(LENGTHS), metric
    assert found["reach_wrist"] == [1.0] * len(LENGTHS)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_the_size_of_the_chunks_does_not_change_a_bit(dtype) -> None:
    problem = random_problem(2, LENGTHS * 3, dtype=dtype)
    whole = values(*problem, chunk_frames=10**9)
    for chunk_frames in (1, 50, 333):
        assert values(*problem, chunk_frames=chunk_frames) == whole


@settings(max_examples=25, deadline=None)
@given(order=st.permutations(range(len(LENGTHS))), seed=st.integers(0, 99))
def test_the_order_of_the_batch_does_not_change_a_bit(order: list[int], seed: int) -> None:
    predicted, recorded, where = random_problem(seed, LENGTHS)
    straight = values(predicted, recorded, where)
    mixed = values(reordered(predicted, order), reordered(recorded, order), reordered_targets(where, order))
    assert mixed == {metric: [found[i] for i in order] for metric, found in straight.items()}


@settings(max_examples=25, deadline=None)
@given(
    yaw=st.floats(-3.2, 3.2),
    shift=st.tuples(st.floats(-5, 5), st.floats(-5, 5)),
    seed=st.integers(0, 99),
)
def test_turning_and_moving_the_world_changes_no_score(yaw: float, shift: tuple[float, float], seed: int) -> None:
    predicted, recorded, where = random_problem(seed, LENGTHS)
    move = np.array([shift[0], 0.0, shift[1]])

    def moved(motion: MotionBatch) -> MotionBatch:
        return MotionBatch(turned(motion.values, yaw) + move, motion.offsets)

    goal = turned(where.goal_location[:, None], yaw)[:, 0] + move
    there = ScoringTargets(goal, where.prime_time, where.hand, where.head_tilt_deg, where.fps)
    before, after = values(predicted, recorded, where), values(moved(predicted), moved(recorded), there)
    for metric in before:
        np.testing.assert_allclose(after[metric], before[metric], atol=1e-9, err_msg=metric)


def test_padding_never_reaches_the_score() -> None:
    predicted, recorded, where = random_problem(3, LENGTHS)
    padded = [np.full((len(LENGTHS), 250, 22, 3), fill) for fill in (np.nan, 1e9)]
    for motion, target in zip((predicted, recorded), padded, strict=True):
        for i, n in enumerate(LENGTHS):
            target[i, :n] = motion.values[motion.offsets[i] : motion.offsets[i] + n]
    batches = [MotionBatch.from_padded(values, np.array(LENGTHS)) for values in padded]
    assert values(*batches, where) == values(predicted, recorded, where)


@pytest.mark.parametrize("fps", [0.0, -20.0, np.nan, np.inf])
def test_a_frame_rate_that_is_not_positive_is_refused(fps: float) -> None:
    _, _, where = random_problem(0, [5, 6])
    for rates in (fps, np.array([20.0, fps])):
        with pytest.raises(ValueError, match="expected positive frame rates"):
            ScoringTargets(where.goal_location, where.prime_time, where.hand, where.head_tilt_deg, rates)


@pytest.mark.parametrize(("spoilt", "name"), [(0, "predicted"), (1, "recorded")])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_not_finite_is_named(spoilt: int, name: str, bad: float) -> None:
    problem = random_problem(4, LENGTHS)
    motion = problem[spoilt]
    motion.values[motion.offsets[6] + 101, 7, 1] = bad
    for chunk_frames in (10, 10**6):
        with pytest.raises(ValueError, match=f"{name} motion, sequence 6, frame 101: a joint is not finite"):
            score(*problem, CONSTANTS, chunk_frames=chunk_frames)


def test_other_lengths_are_refused_unless_allowed() -> None:
    predicted, recorded = batch(standing(6), standing(3)), batch(standing(6), standing(5))
    recorded.values[6 + 3 :] += (1.0, 0.0, 0.0)  # the frames that the second prediction lacks
    where = targets(2)
    with pytest.raises(ValueError, match="sequence 1: expected 5 frames, found 3"):
        score(predicted, recorded, where, CONSTANTS)
    found = score(predicted, recorded, where, CONSTANTS, allow_length_mismatch=True)
    assert found["mpjpe"].value.tolist() == [0.0, 0.0]
    assert found["goal_mpjpe"].value == pytest.approx([0.0, 1.0])
    assert found["location_error"].value.tolist() == [0.0, 1.0]
    assert found["mpjpe"].flag == [None, "length_mismatch"]
    assert found["prime_success"].flag == [None, "no_candidate_frames;length_mismatch"]
    assert found["contact_share"].value.tolist() == [1.0, 1.0]


def test_one_frame_is_enough_for_goal_mpjpe_and_location_error_only() -> None:
    one = batch(standing(1), standing(3))
    found = score(one, one, targets(2), CONSTANTS, metrics=["goal_mpjpe", "location_error"])
    assert {metric: v.value.tolist() for metric, v in found.items()} == {"goal_mpjpe": [0, 0], "location_error": [0, 0]}
    with pytest.raises(ValueError, match="sequence 0: expected 2 frames or more, found 1"):
        score(one, one, targets(2), CONSTANTS)


def test_an_unknown_metric_is_answered_with_the_known_ones() -> None:
    with pytest.raises(ValueError, match="unknown metric 'fid'; known ones are: prime_success, "):
        score(*random_problem(0, [5]), CONSTANTS, metrics=["fid"])


def test_wrong_forms_are_refused() -> None:
    with pytest.raises(ValueError, match="sequence 1 has no frames"):
        MotionBatch(standing(3), np.array([0, 3, 3]))
    with pytest.raises(ValueError, match="offsets must run from 0 to 3, found 0 to 2"):
        MotionBatch(standing(3), np.array([0, 2]))
    with pytest.raises(ValueError, match="sequence 1: 6 frames asked of 5"):
        MotionBatch.from_padded(np.zeros((2, 5, 22, 3)), np.array([5, 6]))
    with pytest.raises(ValueError, match="sequence 0: its prime time is not finite"):
        targets(prime_time=np.nan)
    with pytest.raises(ValueError, match=r"expected 0 \(left\), 1 \(right\) or -1"):
        targets(hand=2)
    one, two = batch(standing(3)), batch(standing(3), standing(3))
    with pytest.raises(ValueError, match="as many predicted as recorded motions and targets, found 2, 1 and 1"):
        score(two, one, targets(1), CONSTANTS)
    short = GazeRays(np.zeros((2, 3)), np.zeros((2, 3)), np.ones(2, bool))
    with pytest.raises(ValueError, match="expected 3 gaze rays, found 2"):
        score(one, one, targets(gaze=short), CONSTANTS)


FAMILY = """
from prbench.metrics.registry import MetricFamily, MetricInfo

def compute(pair, constants):
    raise NotImplementedError

INFO = MetricInfo(
    "{id}", "T", "m", higher_is_better=None, main=False, position={position}, compares_with_recorded=True
)
FAMILY = MetricFamily((INFO,), compute)
"""


def info(unit: str = "m", **said) -> MetricInfo:
    about = {"higher_is_better": None, "main": False, "position": 30, "compares_with_recorded": False} | said
    return MetricInfo("made_up", "Made up", unit, **about)


def test_rates_are_printed_in_percent_and_all_other_units_as_they_are():
    printed = {
        unit: (info(unit).scale, printed_unit(unit), exported_unit(unit)) for unit in ("rate", "ratio", "m", "°")
    }
    assert printed == {
        "rate": (100.0, " %", "%"),
        "ratio": (1.0, "", "ratio"),
        "m": (1.0, " m", "m"),
        "°": (1.0, " °", "°"),
    }
    assert [info(higher_is_better=better).arrow for better in (True, False, None)] == [" ↑", " ↓", ""]


def test_an_interval_reaches_below_zero_only_where_a_value_can():
    values = np.array([0.0, 0.0, 0.0, 1.0])
    recordings = ["a", "b", "c", "d"]
    assert metric_interval(info(), values, recordings).low == 0.0
    assert metric_interval(info(can_be_negative=True), values, recordings).low < 0.0


@pytest.fixture
def package(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(tmp_path))

    def made(**modules: str):
        folder = tmp_path / "made_up_metrics"
        folder.mkdir()
        (folder / "__init__.py").touch()
        for name, source in modules.items():
            (folder / f"{name}.py").write_text(source)
        return find_families("made_up_metrics", [str(folder)])

    yield made
    for name in [name for name in sys.modules if name.startswith("made_up_metrics")]:
        del sys.modules[name]


def test_families_are_found_in_their_files_and_sorted_by_position(package):
    found = package(a=FAMILY.format(id="late", position=2), b=FAMILY.format(id="early", position=1), c="")
    assert [family.metrics[0].id for family in found] == ["early", "late"]


def test_an_id_that_two_files_use_is_refused(package):
    source = FAMILY.format(id="mine", position=1)
    with pytest.raises(ValueError, match="an id of its own, found 'mine' twice"):
        package(a=source, b=source)
