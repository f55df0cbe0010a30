"""A synthetic tree: what stands in it, and that nothing but its arguments decides a byte."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.readers import read_synthetic_tree, reader_for
from prbench.synthetic.people import perform
from prbench.synthetic.write_tree import WrittenTree, own_tables, synthesize_tree
from tests.synthetic.true_clips import read_truth

TRUTH_OF_A_FRAME = ("recording_id", "t", "joints", "rotations", "eye", "gaze", "head_forward", "planted")


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> WrittenTree:
    return synthesize_tree("adt", tmp_path_factory.mktemp("trees") / "tree", recordings=2, seed=4, n_events=2)


def _digests(root: Path) -> dict[str, str]:
    files = sorted(path for path in root.rglob("*") if path.is_file())
    return {str(path.relative_to(root)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def test_a_recording_does_not_depend_on_how_many_there_are(tree, tmp_path) -> None:
    alone = synthesize_tree("adt", tmp_path / "alone", recordings=1, seed=4, n_events=2)
    name = alone.recordings[0].recording_id
    assert _digests(alone.root / name) == _digests(tree.root / name)


def test_the_tree_says_that_it_is_synthetic_and_how_it_is_split(tree) -> None:
    mark = read_synthetic_tree(tree.root)
    assert mark is not None
    assert (mark.seed, mark.preset, mark.world) == (4, "adt", "default")
    assert mark.split == {recording.recording_id: recording.split for recording in tree.recordings}
    found = reader_for("adt").find(tree.root)
    assert {recording.recording_id for recording in found} == mark.split.keys()
    assert {recording.dataset for recording in found} == {"synthetic-adt"}


def test_truth_events_are_on_the_recording_s_clock_after_adding_its_offset(tree) -> None:
    recordings = read_truth(tree.root, "recordings").to_pylist()
    events = read_truth(tree.root, "events").to_pylist()
    by_id = {found.recording_id: reader_for("adt").read(found) for found in reader_for("adt").find(tree.root)}
    assert {row["recording_id"] for row in recordings} == by_id.keys()
    for row in recordings:
        recording = by_id[row["recording_id"]]
        offset = row["clock_offset_s"]["objects"]
        assert recording.span[0] == pytest.approx(offset)
        assert row["participant_id"] == recording.participant_id
        for event in (event for event in events if event["recording_id"] == row["recording_id"]):
            track = recording.object(event["object_id"])
            if event["kind"] != "pick" or event["tag"] == "lost":
                continue
            around = offset + event["event_s"] + np.array([-0.2, 1.0])
            position, rotation = track.pose_at(around)
            lower, upper = track.world_box(position, rotation)
            centre = (lower + upper) / 2
            assert centre[0] == pytest.approx(event["goal"], abs=2e-3), "still at the goal shortly before"
            assert np.linalg.norm(centre[1] - event["goal"]) > 0.05, "moving after it"


def test_truth_tables_hold_what_the_page_lists(tree) -> None:
    joints = read_truth(tree.root, "joints")
    assert joints.column_names == list(TRUTH_OF_A_FRAME)
    steps = np.diff(joints["t"].to_numpy())
    assert np.median(steps) == pytest.approx(1 / 30), "tiny trees keep 30 Hz"
    events = read_truth(tree.root, "events")
    assert {"prime_s", "prime_first_s", "prime_kind", "expected", "thin", "goal", "box_min", "box_max"} <= set(
        events.column_names
    )
    assert read_truth(tree.root, "fixations").num_rows > 10


def test_object_truth_keeps_rows_while_moving_and_both_ends() -> None:
    performance = perform("adt", seed=11, index=3, n_events=2, provocations={})
    table = own_tables(performance, rate=30.0)["objects"]
    moved = {motion.object_id for motion in performance.objects if len(motion.position) > 1}
    still = [motion for motion in performance.objects if len(motion.position) == 1]
    counts = {entry["values"]: entry["counts"] for entry in table["object_id"].value_counts().to_pylist()}
    assert all(counts[motion.object_id] == 1 for motion in still)
    for key in moved:
        motion = next(motion for motion in performance.objects if motion.object_id == key)
        poses = np.hstack([motion.position, motion.rotation])
        last = len(poses) - 1
        kept = [
            i
            for i in range(last + 1)
            if i in (0, last) or (poses[i - 1] != poses[i]).any() or (poses[i] != poses[i + 1]).any()
        ]
        assert counts[key] == len(kept)
        assert len(kept) < last


def test_an_older_synthetic_tree_is_replaced_and_anything_else_is_not(tree, tmp_path) -> None:
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.tex").write_text("years of work")
    with pytest.raises(UsageError, match="no synthetic tree"):
        synthesize_tree("adt", mine, recordings=1, n_events=1)
    assert (mine / "thesis.tex").read_text() == "years of work"
    out = tmp_path / "tree"
    synthesize_tree("adt", out, recordings=1, seed=1, n_events=1)
    synthesize_tree("adt", out, recordings=1, seed=2, n_events=1)
    assert len(list(out.glob("Apartment*"))) == 1


def test_a_failure_leaves_nothing_behind(tmp_path) -> None:
    def stop(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        synthesize_tree("adt", tmp_path / "tree", recordings=2, n_events=1, on_written=stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"size": "large"}, "--table"),
        ({"preset": "unheard-of"}, "no native files"),
        ({"recordings": 0}, "at least one"),
    ],
    ids=["large", "preset without files", "none"],
)
def test_what_cannot_be_written_is_refused_with_a_reason(tmp_path, arguments, words) -> None:
    preset = arguments.pop("preset", "adt")
    with pytest.raises(UsageError, match=words):
        synthesize_tree(preset, tmp_path / "tree", **arguments)


def test_what_a_killed_run_left_beside_the_tree_is_cleared_away(tmp_path) -> None:
    left = tmp_path / ".tree-abcd_123.partial"
    (left / "half a recording").mkdir(parents=True)
    synthesize_tree("adt", tmp_path / "tree", recordings=1, seed=4, n_events=1)
    assert [path.name for path in tmp_path.iterdir()] == ["tree"]
