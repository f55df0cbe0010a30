"""The six metrics on arrays of one's own: equal to the harness's values, and clear where something is missing."""

from __future__ import annotations

import doctest

import numpy as np
import pytest

import prbench
from prbench.api import measuring
from prbench.metrics import METRICS, METRICS_OF_MOTIONS
from tests.fakes import smooth_motion

SIX = [info.id for info in METRICS if info.in_study]


@pytest.fixture(scope="module")
def predicted(runs):
    """Motions of the run ``scripted`` by sequence id."""
    return {name: runs[1].motion(name) for name in runs[1].to_pandas().sequence_id.unique()}


def _everything(sequence: prbench.Sequence) -> dict[str, object]:
    return {
        "recorded": sequence.joints,
        "goal_location": sequence.goal.location,
        "prime_time": sequence.prime_after,
        "head_tilt_deg": sequence.head_tilt_deg,
        "fps": sequence.fps,
        "hand": sequence.hand,
    }


def test_the_example_of_the_docstring_runs():
    finder = doctest.DocTestFinder(recurse=False)
    (example,) = finder.find(measuring.measure, "measure", globs={})
    found = doctest.DocTestRunner().run(example)
    assert found.attempted >= 10
    assert found.failed == 0


def test_one_motion_gets_the_values_of_the_run(table, runs, predicted):
    scored = runs[1].to_pandas().set_index(["sequence_id", "metric"]).value
    variants = [info.id for info in METRICS_OF_MOTIONS]
    for name, motion in predicted.items():
        sequence = table.sequence(name)
        measures = prbench.measure(motion, **_everything(sequence))
        assert list(measures) == SIX
        assert measures.left_out == {}
        assert dict(measures) == {metric: scored[name, metric] for metric in SIX}
        others = prbench.measure(motion, metrics=variants, **_everything(sequence))
        assert dict(others) == {metric: scored[name, metric] for metric in variants}


def test_a_batch_gets_the_values_of_its_motions(table, predicted):
    names = list(predicted)
    sequences = [table.sequence(name) for name in names]
    single = [prbench.measure(predicted[name], **_everything(one)) for name, one in zip(names, sequences, strict=True)]
    columns = {key: [_everything(one)[key] for one in sequences] for key in _everything(sequences[0])}
    lengths = np.array([len(predicted[name]) for name in names])
    padded = np.full((len(names), lengths.max() + 3, 22, 3), np.nan)
    recorded = padded.copy()
    for row, name in enumerate(names):
        padded[row, : lengths[row]] = predicted[name]
        recorded[row, : lengths[row]] = sequences[row].joints
    as_list = prbench.measure([predicted[name] for name in names], **columns)
    as_array = prbench.measure(padded, n_frames=lengths, **{**columns, "recorded": recorded})
    for several in (as_list, as_array):
        frame = several.to_pandas()
        assert list(frame) == SIX
        for metric in SIX:
            expected = [one[metric] for one in single]
            assert several[metric].tolist() == frame[metric].tolist() == expected
            assert several.mean()[metric] == pytest.approx(np.mean(expected))


def test_other_forms_of_the_same_arrays_get_the_same_values(table):
    sequence = table[0]
    motion = sequence.joints + 0.01
    given = _everything(sequence)
    expected = dict(prbench.measure(motion, **given))
    batch = prbench.measure(motion[None], **given | {"recorded": sequence.joints[None]})
    assert {metric: values.tolist() for metric, values in batch.items()} == {
        key: [one] for key, one in expected.items()
    }
    assert dict(prbench.measure(motion.tolist(), **{**given, "recorded": sequence.joints.tolist()})) == expected
    torch = pytest.importorskip("torch")
    assert dict(prbench.measure(torch.tensor(motion), **given)) == expected


def test_a_box_stands_for_its_centre(synthetic):
    sequence = synthetic[0]
    goal = sequence.goal
    at_centre = prbench.measure(sequence.joints, goal_location=goal.box_corners.mean(axis=0))
    assert dict(prbench.measure(sequence.joints, goal_box=goal.box_corners)) == dict(at_centre)
    low, high = np.array([0.0, 0.5, 1.0]), np.array([0.2, 0.7, 1.4])
    centre = prbench.measure(sequence.joints, goal_location=(low + high) / 2)
    assert dict(prbench.measure(sequence.joints, goal_box=[low, high])) == dict(centre)
    twice = prbench.measure([sequence.joints] * 2, goal_box=np.stack([[low, high]] * 2))
    assert twice["reach_success"].tolist() == [centre["reach_success"]] * 2


@pytest.mark.parametrize(
    ("names", "computed"),
    [
        ((), []),
        (("recorded",), ["goal_mpjpe", "location_error", "mpjpe"]),
        (("fps",), ["foot_skating"]),
        (("goal_location",), ["reach_success"]),
        (("goal_location", "prime_time", "head_tilt_deg"), ["reach_success"]),
        (("goal_location", "prime_time", "head_tilt_deg", "fps"), ["prime_success", "reach_success", "foot_skating"]),
    ],
)
def test_what_is_not_given_is_left_out_by_name(table, names, computed):
    sequence = table[0]
    given = {name: value for name, value in _everything(sequence).items() if name in names}
    everything = prbench.measure(sequence.joints + 0.02, **_everything(sequence))
    measures = prbench.measure(sequence.joints + 0.02, **given)
    assert list(measures) == computed
    assert dict(measures) == {metric: everything[metric] for metric in computed}
    assert set(measures.left_out) == set(SIX) - set(computed)
    for metric, why in measures.left_out.items():
        assert why.startswith("needs ")
        assert metric not in measures
        with pytest.raises(KeyError, match=f"{metric} was left out: it needs"):
            measures[metric]
        title = next(info.title for info in METRICS if info.id == metric)
        assert f"{title} left out: {why}" in repr(measures)
        assert f"{title} left out: {why}" in measures._repr_html_()


@pytest.mark.parametrize(
    ("metric", "names"),
    [
        ("prime_success_arrival", ("goal_location", "prime_time", "head_tilt_deg", "fps")),
        ("prime_success_angle", ("goal_location", "prime_time", "head_tilt_deg", "fps")),
        ("first_frame_error", ("recorded",)),
        ("first_step", ()),
        ("floating", ()),
        ("penetration", ()),
        ("slow_slides", ("fps",)),
        ("largest_jerk", ("fps",)),
        ("largest_speed", ("fps",)),
        ("plausible", ("goal_location", "head_tilt_deg", "fps")),
        ("plausible_3", ("fps",)),
    ],
)
def test_a_metric_beside_the_six_needs_no_more_than_it_reads(table, metric, names):
    sequence = table[0]
    moved = sequence.joints + 0.02
    everything = _everything(sequence)
    given = {name: value for name, value in everything.items() if name in names}
    expected = prbench.measure(moved, **everything, metrics=[metric])[metric]
    assert prbench.measure(moved, **given, metrics=[metric])[metric] == expected
    for name in names:
        fewer = {key: value for key, value in given.items() if key != name}
        assert metric in prbench.measure(moved, **fewer, metrics=[metric]).left_out


def test_a_metric_that_somebody_adds_is_taken_to_need_everything(monkeypatch):
    monkeypatch.delitem(measuring._NEEDS, "mpjpe")
    left_out = prbench.measure(MOTION, metrics=["mpjpe"]).left_out
    assert left_out == {"mpjpe": "needs recorded, goal_location (or goal_box), prime_time, head_tilt_deg, fps"}


def test_flags_are_handed_over(table):
    sequence = table[0]
    short = sequence.joints[:3]
    given = _everything(sequence) | {"recorded": short, "prime_time": 0.0}
    assert prbench.measure(short, **given).flags == {"prime_success": ["no_candidate_frames"]}


MOTION = smooth_motion("measure", 40)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"predicted": MOTION[:, :21]}, r"predicted: expected \(n, 22, 3\).*found the shape \(40, 21, 3\)"),
        ({"predicted": np.zeros((0, 22, 3))}, r"found the shape \(0, 22, 3\)"),
        ({"predicted": "motion"}, "predicted: expected numbers, found str"),
        (
            {"predicted": np.where(np.arange(40)[:, None, None] == 7, np.nan, MOTION)},
            "frame 7: expected finite positions",
        ),
        ({"predicted": MOTION * 1000}, "positions are in millimetres"),
        ({"recorded": MOTION[:-1]}, "as many predicted as recorded frames, found 40 and 39"),
        ({"recorded": [MOTION, MOTION]}, "recorded: expected 1 motions, as many as predicted, found 2"),
        ({"goal_location": [1.0, 2.0]}, r"goal_location: expected \(3,\) or \(1, 3\), found the shape \(2,\)"),
        ({"goal_location": [0, 1, 0], "goal_box": np.zeros((2, 3))}, "give one of them"),
        ({"goal_box": np.zeros((3, 3))}, r"goal_box: expected \(2, 3\) or \(8, 3\)"),
        ({"prime_time": 33076.39, "fps": 20}, r"from 0 to 1.95 for motion 0, found 33076.4"),
        ({"prime_time": [1.0, 1.0], "fps": 20}, r"prime_time: expected one number or 1"),
        ({"fps": 0}, "expected positive frame rates"),
        ({"goal_location": [0, np.nan, 0]}, "its goal location is not finite"),
        ({"hand": "both"}, "hand: expected left, right or None, found 'both'"),
        ({"hand": ["left", "right"]}, "hand: expected 1 of them"),
        ({"n_frames": 41}, r"n_frames\[0\]: expected 1 to 40"),
        ({"n_frames": [3, 4]}, "n_frames: expected 1 numbers"),
        ({"metrics": ["mpjp"]}, "unknown metric 'mpjp'.*Did you mean 'mpjpe'"),
        ({"metrics": ["foot_skating"], "predicted": MOTION[:1], "fps": 20}, "expected 2 frames or more, found 1"),
    ],
)
def test_unfit_arguments_are_refused_with_what_was_expected(changes, message):
    arguments = {"predicted": MOTION} | changes
    with pytest.raises(prbench.PrbenchError, match=message):
        prbench.measure(arguments.pop("predicted"), **arguments)
