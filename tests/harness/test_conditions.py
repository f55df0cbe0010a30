"""The firewall: what a method is given, and what it cannot get at from there."""

from __future__ import annotations

import dataclasses
import gc
import hashlib
import hmac
import pickle

import numpy as np
import pytest

from prbench.contract import GIVEN, Condition, ConditionBatch
from prbench.errors import UsageError
from prbench.harness import planning
from prbench.harness.conditions import (
    SCENE_COLUMNS,
    ConditionSource,
    ConditionStream,
    boxes_around,
    derangement,
    opaque_ids,
    run_salt,
    solid_boxes,
)
from prbench.harness.planning import select
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.harness.run_folder.summary import DatasetAgreement
from prbench.randomness import noise_seed
from tests.fakes import fake_box, fake_dataset, fake_sequence
from tests.harness.test_run import request

ALWAYS = {"condition", "n_frames", "fps", "opaque_id", "noise_seed"}
SPECIFIED = {
    Condition.NONE: set(),
    Condition.TEXT: {"text"},
    Condition.GOAL_POSE: {"text", "initial_joints", "previous_joints", "goal_joints"},
    Condition.GOAL_LOCATION: {"text", "initial_joints", "previous_joints", "goal_location"},
}


@pytest.fixture(scope="module")
def source(table):
    return ConditionSource.read(select(table, split="test", limit=None))


def batch_of(source, condition, rows=(0, 3, 2), sample=0):
    return source.batch(np.array(rows), condition, seed=7, salt=run_salt(7, "identity"), sample=sample)


def recorded(source, row):
    index = int(source.sequence_ids[row].split("/obj")[1].split("/")[0])
    return fake_sequence(index)


@pytest.mark.parametrize("condition", Condition)
def test_a_batch_holds_exactly_what_the_design_lists(source, condition):
    batch = batch_of(source, condition)
    filled = {f.name for f in dataclasses.fields(batch) if getattr(batch, f.name) is not None}
    assert filled == ALWAYS | SPECIFIED[condition]
    assert {f.name for f in dataclasses.fields(ConditionBatch)} == ALWAYS | set().union(*SPECIFIED.values())
    assert set(vars(batch)) == {f.name for f in dataclasses.fields(ConditionBatch)}


def test_values_are_those_of_the_rows_asked_for(source):
    for condition in (Condition.GOAL_POSE, Condition.GOAL_LOCATION):
        batch = batch_of(source, condition)
        for i, row in enumerate((0, 3, 2)):
            truth = recorded(source, row)
            assert np.array_equal(batch.initial_joints[i], truth.joints[0])
            assert np.array_equal(batch.previous_joints[i], truth.previous_joints)
            assert batch.n_frames[i] == truth.n_frames
            assert batch.text[i] == truth.text
            if batch.goal_joints is not None:
                assert np.array_equal(batch.goal_joints[i], truth.joints[-1])
            if batch.goal_location is not None:
                assert np.array_equal(batch.goal_location[i], truth.goal_location)


@pytest.mark.parametrize("condition", Condition)
def test_no_recorded_frame_beyond_those_given_can_be_reached_from_a_batch(source, condition):
    batch = batch_of(source, condition)
    reachable = [item for item in _reachable(batch) if isinstance(item, np.ndarray)]
    pickled = pickle.dumps(batch)
    for row in (0, 3, 2):
        truth = recorded(source, row)
        hidden = truth.joints[1:-1]
        if "goal_joints" not in GIVEN[condition]:
            hidden = truth.joints[1:]
        if "initial_joints" not in GIVEN[condition]:
            hidden = truth.joints
        for frame in hidden:
            assert frame.tobytes() not in pickled
            assert not any(frame.tobytes() in array.tobytes() for array in reachable)
        for secret in (truth.gaze_direction.astype(np.float32), np.float64(truth.prime_time)):
            assert secret.tobytes() not in pickled
        for name in (truth.sequence_id, truth.recording_id, truth.object_id):
            assert name.encode() not in pickled


def test_the_search_above_would_find_a_leak(source):
    truth = recorded(source, 0)
    leaking = dataclasses.replace(batch_of(source, Condition.GOAL_LOCATION, rows=(0,)))
    object.__setattr__(leaking, "initial_joints", truth.joints[:1])  # a view: its base is the whole motion
    reachable = [item for item in _reachable(leaking) if isinstance(item, np.ndarray)]
    assert any(truth.joints[5].tobytes() in array.tobytes() for array in reachable)


def _reachable(root):
    found, waiting, seen = [], [root], set()
    while waiting:
        item = waiting.pop()
        if id(item) in seen or isinstance(item, type):
            continue
        seen.add(id(item))
        found.append(item)
        if isinstance(item, np.ndarray):
            waiting.append(item.base)
        elif isinstance(item, (tuple, list, dict)) or hasattr(item, "__dict__"):
            waiting += [x for x in gc.get_referents(item) if not callable(x) and not hasattr(x, "__spec__")]
    return found


def test_goal_location_never_comes_with_the_goal_pose(source):
    assert batch_of(source, Condition.GOAL_LOCATION).goal_joints is None
    given = {name: getattr(batch_of(source, Condition.GOAL_POSE), name) for name in ("goal_joints",)}
    with pytest.raises(ValueError, match=r"goal_joints"):
        dataclasses.replace(batch_of(source, Condition.GOAL_LOCATION), **given)


def test_opaque_ids_are_hmacs_under_a_salt_of_seed_and_table(source):
    batch = batch_of(source, Condition.NONE)
    key = hashlib.sha256(b"prbench opaque ids/7/identity").digest()
    expected = [hmac.new(key, source.sequence_ids[row].encode(), "sha256").hexdigest() for row in (0, 3, 2)]
    assert list(batch.opaque_id) == expected
    assert opaque_ids(["a"], run_salt(7, "x")) != opaque_ids(["a"], run_salt(8, "x"))
    assert opaque_ids(["a"], run_salt(7, "x")) != opaque_ids(["a"], run_salt(7, "y"))


def test_noise_depends_on_seed_sequence_and_sample_but_not_on_the_batch(source):
    first = batch_of(source, Condition.NONE)
    assert first.noise_seed[1] == noise_seed(7, source.sequence_ids[3], 0)
    assert batch_of(source, Condition.NONE, rows=(3,)).noise_seed[0] == first.noise_seed[1]
    again = source.redrawn(first, np.array([0, 3, 2]), seed=7, sample=1)
    assert set(again.noise_seed).isdisjoint(first.noise_seed)
    assert batch_of(source, Condition.NONE, sample=1).noise_seed == again.noise_seed
    assert again.opaque_id == first.opaque_id


def test_shuffled_goals_leave_no_sequence_its_own_and_use_each_once(table):
    selection = select(table, split="test", limit=None)
    order = derangement(selection, seed=3)
    assert sorted(order) == list(range(len(selection)))
    assert (order != np.arange(len(selection))).all()
    assert np.array_equal(order, derangement(selection, seed=3))
    assert not np.array_equal(order, derangement(selection, seed=4))


def test_shuffled_goals_change_the_goal_and_nothing_else(source, table):
    order = derangement(select(table, split="test", limit=None), seed=3)
    shuffled = source.with_goals_of(order)
    rows = np.arange(len(order))
    salt = run_salt(0, "identity")
    for condition, goal in ((Condition.GOAL_POSE, "goal_joints"), (Condition.GOAL_LOCATION, "goal_location")):
        own = source.batch(rows, condition, seed=0, salt=salt, sample=0)
        other = shuffled.batch(rows, condition, seed=0, salt=salt, sample=0)
        assert np.array_equal(getattr(other, goal), getattr(own, goal)[order])
        for name in {f.name for f in dataclasses.fields(own)} - {goal}:
            assert np.array_equal(getattr(own, name), getattr(other, name)), name


def test_goals_of_a_single_sequence_cannot_be_shuffled(table):
    with pytest.raises(UsageError, match=r"two sequences or more, found 1"):
        derangement(select(table, split="test", limit=1), seed=0)


def test_a_stream_gives_the_conditions_of_the_whole_however_windows_lie(table, source, monkeypatch):
    monkeypatch.setattr(planning, "WINDOW", 4)
    stream = ConditionStream(select(table, split="test", limit=None))
    for rows in ([2, 0, 3], [9], [13, 12, 14], [1, 2]):  # the last ones lie before: they are read again
        own, places = stream.around(np.array(rows))
        assert len(own.sequence_ids) <= 4
        for condition in Condition:
            expected = batch_of(source, condition, rows)
            found = batch_of(own, condition, places)
            for name, value in vars(expected).items():
                np.testing.assert_array_equal(getattr(found, name), value)


BOXES = (fake_box("rec001"), fake_box("rec005", entered=0.3), fake_box("rec009", entered=None))


@pytest.fixture(scope="module")
def table_of_boxes(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("boxes") / "table", 24, boxes=BOXES)


def test_a_box_that_the_person_entered_is_not_solid(table_of_boxes):
    scene = solid_boxes(table_of_boxes)
    assert scene is not None
    for chunk in table_of_boxes.chunks(columns=SCENE_COLUMNS):
        counts = dict(zip(chunk.strings("recording_id"), np.diff(boxes_around(chunk, scene).offsets), strict=True))
        assert {name for name, count in counts.items() if count} == {"rec001", "rec009"}


def test_tables_without_boxes_have_no_scene(table):
    assert solid_boxes(table) is None


def test_a_run_keeps_how_deep_motions_come_into_boxes_and_recorded_people_do(table_of_boxes, tmp_path):
    report = run_method(request(table_of_boxes, tmp_path / "out", "static"))
    part = report.folder.dataset("synthetic-adt")
    rows = [row for row in read_scores(part.scores).to_pylist() if row["metric"] == "scene_penetration"]
    assert {row["value"] for row in rows} == {0.0, 1.0}, "a body that stands in a box, and one without boxes"
    assert {row["flag"] for row in rows} == {"no_boxes", None}
    people = DatasetAgreement.read(part.path).scene
    assert people is not None
    assert (people.boxes, people.solid) == (3, 2)
    assert 0 < people.penetration < 1


def test_a_run_on_a_table_without_boxes_says_nothing_of_them(table, tmp_path):
    report = run_method(request(table, tmp_path / "out", "static"))
    agreement = DatasetAgreement.read(report.folder.dataset("synthetic-adt").path)
    assert agreement.scene is None
    assert report.summaries[0].metric("scene_penetration") is None
