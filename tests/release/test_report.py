"""What the release leaves open is inferred right, and how surely is said; where nothing tells, nothing is guessed."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from prbench.errors import InputFileError, TableError
from prbench.evaluation.request import RunRequest
from prbench.evaluation.run import run_method
from prbench.release import ImportOptions, ImportReport, import_release
from prbench.release.known import load_known
from prbench.release.rates import FrameRateEvidence, infer_frame_rate, read_primed_frames
from prbench.release.report import count_rows, count_warnings
from prbench.release.values import action_of_text, parse_action, parse_goal, parse_subset
from prbench.sequences import SequenceTable
from prbench.skeleton import transform_points
from tests.release.releases import Style, in_world, plain_entry, rows, write_release

ROWS = rows(6)


def imported(folder, sequences=ROWS, style=None, *, options=None, **kinds) -> ImportReport:
    write_release(folder / "release", sequences, style, **kinds)
    result = import_release(
        folder / "release", folder / "table", dataset="synthetic-adt", options=options or ImportOptions()
    )
    return result.reports[0]


def value(report: ImportReport, name: str) -> tuple[str, str]:
    found = next(each for each in report.inferences if each.name == name)
    return found.value, found.certainty


def table_values(folder, name: str) -> list[np.ndarray]:
    chunks = list(SequenceTable.open(folder / "table").chunks())
    return [chunk.vectors(name)[row] for chunk in chunks for row in range(len(chunk))]


def motions(folder) -> list[np.ndarray]:
    chunks = list(SequenceTable.open(folder / "table").chunks())
    return [np.array(c.joints[a:b]) for c in chunks for a, b in zip(c.offsets[:-1], c.offsets[1:])]


@pytest.mark.parametrize(("name", "factor"), [("metres", 1), ("centimetres", 100), ("millimetres", 1000)])
def test_units_are_told_by_the_size_of_people(name, factor, tmp_path) -> None:
    report = imported(
        tmp_path,
        style=Style(goal=lambda goal: [axis * factor for axis in goal]),
        motion=lambda row: row.joints * factor,
    )
    assert value(report, "units")[0] == name
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_allclose(motion, row.joints, atol=2e-6)
    for goal, row in zip(table_values(tmp_path, "goal_location"), ROWS):
        np.testing.assert_allclose(goal, row.goal_location, atol=2e-6)


def test_sizes_of_nobody_are_refused(tmp_path) -> None:
    with pytest.raises(InputFileError, match=r"pelvis to head of 0\.35 to 0\.85 m"):
        imported(tmp_path, motion=lambda row: row.joints * 7)


@pytest.mark.parametrize(("unit", "certainty"), [("m", "certain"), ("cm", None), ("furlongs", "likely")])
def test_a_stated_unit_is_checked(unit, certainty, tmp_path) -> None:
    def stated(row, style):
        return plain_entry(row, style) | {"units": unit}

    if certainty is None:
        with pytest.raises(InputFileError, match="in centimetres as stated"):
            imported(tmp_path, entry=stated)
    else:
        assert value(imported(tmp_path, entry=stated), "units") == ("metres", certainty)


def test_canonical_motions_are_not_touched(tmp_path) -> None:
    report = imported(tmp_path)
    assert value(report, "motion_frame") == ("canonical", "certain")
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_array_equal(motion, row.joints)
    for transform in table_values(tmp_path, "world_from_canonical"):
        np.testing.assert_array_equal(transform.reshape(4, 4), np.eye(4))


def test_world_motions_are_canonicalised_and_goal_and_gaze_with_them(tmp_path) -> None:
    report = imported(tmp_path, [in_world(row) for row in ROWS])
    assert value(report, "motion_frame") == ("world (canonicalised here)", "certain")
    assert value(report, "goal_frame") == ("as the motions", "likely")
    for motion, row in zip(motions(tmp_path), ROWS):
        np.testing.assert_allclose(motion, row.joints, atol=1e-5)
    for goal, row in zip(table_values(tmp_path, "goal_location"), ROWS):
        np.testing.assert_allclose(goal, row.goal_location, atol=1e-5)
    for transform, row in zip(table_values(tmp_path, "world_from_canonical"), ROWS):
        np.testing.assert_allclose(transform.reshape(4, 4), row.world_from_canonical, atol=1e-5)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    np.testing.assert_allclose(
        chunk.frames("gaze_direction")[ROWS[0].gaze_valid.nonzero()[0]],
        ROWS[0].gaze_direction[ROWS[0].gaze_valid],
        atol=1e-5,
    )


def z_up(point: list[float]) -> list[float]:
    return [point[0], -point[2], point[1]]


def test_a_goal_with_z_up_is_turned(tmp_path) -> None:
    report = imported(tmp_path, style=Style(goal=z_up))
    assert value(report, "goal_frame") == ("z up", "likely")
    for goal, row in zip(table_values(tmp_path, "goal_location"), ROWS):
        np.testing.assert_allclose(goal, row.goal_location, atol=1e-12)


@pytest.mark.parametrize(("turn", "name"), [(list, "canonical"), (z_up, "canonical, z up")])
def test_a_canonical_goal_beside_world_motions_is_found(turn, name, tmp_path) -> None:
    canonical = {row.sequence_id: row.goal_location.tolist() for row in ROWS}
    report = imported(
        tmp_path,
        [in_world(row) for row in ROWS],
        entry=lambda row, style: plain_entry(row, style) | {"goal_location": turn(canonical[row.sequence_id])},
    )
    assert value(report, "goal_frame") == (name, "likely")
    for goal, row in zip(table_values(tmp_path, "goal_location"), ROWS):
        np.testing.assert_allclose(goal, row.goal_location, atol=1e-5)


def test_goals_that_fit_nowhere_are_imported_but_never_scored(tmp_path) -> None:
    report = imported(tmp_path, style=Style(goal=lambda goal: [axis + 20 for axis in goal]))
    assert value(report, "goal_frame") == ("unknown", "unknown")
    assert any("frame, base" in warning.lower() for warning in report.warnings)
    with pytest.raises(TableError, match=r"cannot be scored: .*goals are in an unknown frame"):
        run_method(RunRequest(method="ground-truth", data=(tmp_path / "table",), out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_boxes_are_kept_and_their_centre_is_the_goal(tmp_path) -> None:
    half = np.array([0.1, 0.2, 0.3])
    for folder, form in (
        ("six", lambda goal: [*(np.array(goal) - half), *(np.array(goal) + half)]),
        ("named", lambda goal: {"min": (np.array(goal) - half).tolist(), "max": (np.array(goal) + half).tolist()}),
    ):
        imported(tmp_path / folder, style=Style(goal=form))
        for name, sign in (("goal_box_world_min", -1), ("goal_box_world_max", 1)):
            for corner, row in zip(table_values(tmp_path / folder, name), ROWS):
                np.testing.assert_allclose(corner, row.goal_location + sign * half, atol=1e-9)


def test_a_box_in_a_turned_frame_becomes_the_box_around_it(tmp_path) -> None:
    half = np.array([0.1, 0.2, 0.3])
    canonical = {row.sequence_id: row.goal_location for row in ROWS}

    def entry(row, style):
        goal = canonical[row.sequence_id]
        return plain_entry(row, style) | {"goal_location": [*(goal - half), *(goal + half)]}

    imported(tmp_path, [in_world(row) for row in ROWS], entry=entry)
    highs, lows = table_values(tmp_path, "goal_box_world_max"), table_values(tmp_path, "goal_box_world_min")
    for low, high, row in zip(lows, highs, ROWS):
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
        world = transform_points(row.world_from_canonical, row.goal_location + corners)
        np.testing.assert_allclose(low, world.min(axis=0), atol=1e-5)
        np.testing.assert_allclose(high, world.max(axis=0), atol=1e-5)


def test_the_mean_length_and_the_primed_frames_tell_the_rate() -> None:
    known = load_known().datasets["hd-epic"]
    generator = np.random.default_rng(0)
    for rate in (20.0, 25.0, 30.0):
        lengths = np.rint(generator.normal(known.duration, known.duration_sd, 4000).clip(3) * rate).astype(int)
        primes = np.where(generator.uniform(size=4000) < 0.9, 2 * rate, 2 * rate - 5)
        evidence = FrameRateEvidence(lengths, primes, np.empty(0), None, known)
        found, inference = infer_frame_rate(evidence, read_primed_frames(primes, lengths))
        assert (found, inference.certainty) == (rate, "likely")
        alone = dataclasses.replace(evidence, known=None)
        assert infer_frame_rate(alone, read_primed_frames(primes, lengths))[1].certainty == "assumed"


def test_a_rate_that_nothing_tells_or_that_is_contradicted_is_unknown() -> None:
    known = load_known().datasets["hd-epic"]
    lengths, primes = np.full(4000, round(known.duration * 30)), np.full(4000, 40.0)
    primed = read_primed_frames(primes, lengths)
    found, inference = infer_frame_rate(FrameRateEvidence(lengths, primes, np.empty(0), None, known), primed)
    assert (found, inference.certainty) == (None, "unknown")
    assert "near 20" in inference.evidence
    assert "near 30" in inference.evidence
    odd = np.full(4000, 7.0)
    assert infer_frame_rate(FrameRateEvidence(lengths, odd, np.empty(0), None, None), primed)[0] is None


def test_an_untold_rate_has_to_be_given(tmp_path) -> None:
    moved = [dataclasses.replace(row, prime_frame=int(5 + 3 * i)) for i, row in enumerate(ROWS)]
    with pytest.raises(InputFileError, match=r"frame rate.*--fps"):
        imported(tmp_path / "without", moved)
    assert not (tmp_path / "without" / "table").exists()
    report = imported(tmp_path / "with", moved, options=ImportOptions(fps=20.0))
    assert value(report, "fps") == ("20", "certain")


def test_frames_from_one_and_seconds_are_recognised(tmp_path) -> None:
    early = [dataclasses.replace(ROWS[0], prime_frame=0), *ROWS[1:]]
    one = imported(
        tmp_path / "one",
        early,
        entry=lambda row, style: plain_entry(row, style) | {"primed_frame": row.prime_frame + 1},
    )
    assert value(one, "primed_frame") == ("frames from 1", "likely")
    seconds = imported(
        tmp_path / "seconds",
        early,
        entry=lambda row, style: plain_entry(row, style) | {"primed_frame": row.prime_frame / 20 + 0.01, "fps": 20},
    )
    assert value(seconds, "primed_frame") == ("seconds", "likely")
    for folder, late in (("one", 0.0), ("seconds", 0.01)):
        rows_back = SequenceTable.open(tmp_path / folder / "table").scalars()
        assert rows_back["prime_frame"].to_pylist() == [row.prime_frame for row in early]
        expected = [row.prime_frame / 20 + late for row in early]
        np.testing.assert_allclose(rows_back["prime_time"].to_numpy(), expected, atol=1e-9)


def test_a_gaze_that_misses_the_goals_is_a_warning(tmp_path) -> None:
    report = imported(tmp_path, gaze=lambda row: -row.gaze_direction)
    assert any("Frame, base of the primed frames, or rate" in warning for warning in report.warnings)


def test_frame_zero_can_be_the_frame_before(tmp_path) -> None:
    imported(tmp_path, options=ImportOptions(first_frame_is_previous=True))
    rows_back = SequenceTable.open(tmp_path / "table").scalars()
    assert rows_back["n_frames"].to_pylist() == [row.n_frames - 1 for row in ROWS]
    assert rows_back["prime_frame"].to_pylist() == [row.prime_frame - 1 for row in ROWS]
    assert set(rows_back["previous_source"].to_pylist()) == {"recorded"}
    for motion in motions(tmp_path):
        np.testing.assert_allclose(motion[0, 0, [0, 2]], 0, atol=1e-6)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    np.testing.assert_array_equal(
        chunk.frames("gaze_valid"), np.concatenate([row.gaze_valid[1:] for row in ROWS]), "gaze is shifted too"
    )


def test_without_a_frame_before_the_motion_is_continued_backwards(tmp_path) -> None:
    imported(tmp_path)
    chunk = next(SequenceTable.open(tmp_path / "table").chunks())
    joints = chunk.joints[: ROWS[0].n_frames]
    np.testing.assert_allclose(chunk.poses("previous_joints")[0], 2 * joints[0] - joints[1], atol=1e-6)
    assert set(chunk.strings("previous_source")) == {"extrapolated"}


def test_sequences_of_unknown_recordings_are_not_taken_for_independent(tmp_path) -> None:
    imported(tmp_path)
    table = SequenceTable.open(tmp_path / "table")
    assert set(table.recordings()["recording_id"].to_pylist()) == {"unknown-train", "unknown-test"}
    report = run_method(RunRequest(method="ground-truth", data=(table.folder,), out=tmp_path / "run"))
    assert report.summaries[0].recordings == 1


def test_source_recordings_are_taken_where_they_are_told(tmp_path) -> None:
    imported(tmp_path, entry=lambda row, style: plain_entry(row, style) | {"video": row.recording_id})
    names = SequenceTable.open(tmp_path / "table").scalars()["recording_id"].to_pylist()
    assert names == [row.recording_id for row in ROWS]


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("The person picks up a cup.", "pick"), ("A person puts the cup down", "put"), ("someone places it", "put"),
        ("picks/puts an object", None), ("walks around", None), ("she grabbed the pan", "pick"),
        ("returning the bowl", "put"), ("sets down the tray", "put"), ("output device", None),
    ],
)  # fmt: skip
def test_actions_are_read_from_prompts(text, action) -> None:
    assert action_of_text(text) == action


def test_values_in_their_many_forms() -> None:
    assert parse_action("Grab") == "pick"
    assert parse_action(1, "is_put") == "put"
    assert parse_action(0, "pick") == "put"
    assert parse_action(1, "pick_or_put") is None
    assert parse_action(1, "action") is None
    assert parse_subset(1, "is_test") == "test"
    assert parse_subset(False, "train") == "test"
    assert parse_subset(1, "fold") is None
    assert parse_subset("maybe") is None
    for wrong in (None, [1, 2], [1, 2, "x"], [1, 2, float("nan")], "1 2", {"x": 1, "y": 2}, [True, 1, 2], "a b c"):
        assert parse_goal(wrong) is None, wrong


def test_counts_stand_beside_the_studys() -> None:
    known = load_known().datasets["gimo"]
    counts = count_rows(["train"] * 108 + ["test"] * 21, known)
    assert [(row.split, row.found, row.expected) for row in counts] == [("train", 108, 108), ("test", 21, 22)]
    assert count_warnings(counts) == ("test: 21 sequences, the study has 22.",)


def test_every_inference_stands_in_the_report_and_in_the_datasets_options(tmp_path) -> None:
    report = imported(tmp_path)
    written = json.loads((tmp_path / "table" / "import_report.json").read_text("utf-8"))
    names = {each["name"] for each in written["inferred"]}
    assert {
        "fps", "units", "motion_frame", "goal_frame", "skeleton", "primed_frame", "frame_0", "gaze_on_goal",
    } <= names  # fmt: skip
    for each in written["inferred"]:
        assert each["how_surely"] in ("certain", "likely", "assumed", "unknown")
        assert each["evidence"]
        assert report.info.options[f"release.{each['name']}"].startswith(each["value"])
    assert str(tmp_path) not in (tmp_path / "table" / "import_report.json").read_text("utf-8")
    assert str(tmp_path) not in (tmp_path / "table" / "dataset.json").read_text("utf-8")
