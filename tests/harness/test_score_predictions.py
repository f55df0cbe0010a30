"""Scoring motions on disk: a run again, or a file that somebody hands in."""

from __future__ import annotations

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.errors import PredictionsError, RunError, StorageError
from prbench.harness.conditions import opaque_ids, run_salt
from prbench.harness.run import run_method
from prbench.harness.run_folder import DatasetSummary, read_scores
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from tests.fakes import fake_dataset
from tests.harness.test_run import request
from tests.method_fixtures import adapter_source


@pytest.fixture(scope="module")
def recorded(table) -> dict[str, np.ndarray]:
    motions = {}
    for chunk in table.chunks(split="test"):
        for i, name in enumerate(chunk.sequence_ids):
            motions[name] = chunk.joints[chunk.offsets[i] : chunk.offsets[i + 1]]
    return motions


def write(path, motions, *, id_column="sequence_id", samples=None, kind=None):
    """A submission as somebody without our code would make it: nested lists."""
    items = list(motions.items()) if isinstance(motions, dict) else motions
    kind = kind or pa.list_(pa.list_(pa.float32(), 66))
    rows = {
        id_column: [name for name, _ in items],
        "joints": pa.array([motion.reshape(len(motion), -1).tolist() for _, motion in items], type=kind),
    }
    if samples is not None:
        rows["sample"] = samples
    pq.write_table(pa.table(rows), path)
    return path


def score(table, path, **changes):
    (report,) = score_predictions(ScoreRequest(predictions=path, data=(table.folder,), **changes))
    return report


def mean(report, metric):
    return next(item.mean for item in report.summary.metrics if item.metric == metric)


def test_recorded_motion_handed_in_as_a_file_has_no_error(table, recorded, tmp_path):
    report = score(table, write(tmp_path / "mine.parquet", recorded))
    assert mean(report, "mpjpe") == mean(report, "goal_mpjpe") == mean(report, "location_error") == 0.0
    assert mean(report, "reach_wrist") == 1.0
    assert (report.summary.method, report.summary.sequences, report.folder) == ("mine", 15, None)


@pytest.mark.parametrize(
    ("condition", "given"), [("goal-loc", True), ("goal-pose", True), ("text", False), ("none", False), (None, False)]
)
def test_a_body_is_compared_with_the_pose_that_the_declared_condition_shows(
    table, recorded, tmp_path, capsys, condition, given
):
    path = write(tmp_path / "giants.parquet", {name: 1.2 * motion for name, motion in recorded.items()})
    declared = ["--condition", condition] if condition else []
    out = tmp_path / "scored"
    assert main(["score", str(path), "--data", str(table.folder), *declared, "--out", str(out)]) == 0
    flags = DatasetSummary.read(out / "synthetic-adt").metric("plausible").flags
    assert flags.keys() & {"other_start", "own_first_frame"} == {"other_start" if given else "own_first_frame"}
    assert ("15 × own first frame" in " ".join(capsys.readouterr().out.split())) is not given
    assert main(["leaderboard", "export", str(out), "--format", "md"]) == 0
    line = "was given no pose: Plausible compares its bones with its own first frame"
    assert (line in " ".join(capsys.readouterr().out.split())) is not given


@pytest.mark.parametrize(
    "kind",
    [
        pa.list_(pa.list_(pa.float64())),
        pa.large_list(pa.list_(pa.float64(), 66)),
        pa.list_(pa.list_(pa.list_(pa.float32()))),
    ],
)
def test_any_nesting_of_the_66_numbers_is_read(table, recorded, tmp_path, kind):
    deep = pa.types.is_nested(kind.value_type.value_type)
    joints = [m.tolist() if deep else m.reshape(len(m), -1).tolist() for m in recorded.values()]
    pq.write_table(
        pa.table({"sequence_id": list(recorded), "joints": pa.array(joints, type=kind)}), tmp_path / "p.parquet"
    )
    assert mean(score(table, tmp_path / "p.parquet"), "mpjpe") == pytest.approx(0.0, abs=1e-9)


def test_the_order_of_rows_and_their_spread_over_files_change_nothing(table, recorded, tmp_path):
    off = {name: motion + 0.01 * i for i, (name, motion) in enumerate(recorded.items())}
    whole = score(table, write(tmp_path / "p.parquet", off))
    (tmp_path / "parts").mkdir()
    backwards = list(off.items())[::-1]
    for i in range(0, 15, 4):
        write(tmp_path / f"parts/{i:02d}.parquet", backwards[i : i + 4])
    assert score(table, tmp_path / "parts").scores.equals(whole.scores)


def test_opaque_ids_are_resolved_with_the_seed(table, recorded, tmp_path):
    names = opaque_ids(list(recorded), run_salt(4, table.identity))
    path = write(tmp_path / "p.parquet", dict(zip(names, recorded.values())), id_column="opaque_id")
    assert mean(score(table, path, seed=4), "mpjpe") == 0.0
    with pytest.raises(
        PredictionsError, match=r"missing 15 .*unknown 15 .* is --seed 5 that of the run, and --data its table\?"
    ):
        score(table, path, seed=5)


def test_several_samples_are_averaged_within_a_sequence(table, recorded, tmp_path):
    rows = [(name, motion + np.array([0, 0, 0.1 * sample])) for name, motion in recorded.items() for sample in (0, 1)]
    report = score(table, write(tmp_path / "p.parquet", rows, samples=[0, 1] * 15))
    assert report.summary.samples == 2
    assert mean(report, "mpjpe") == pytest.approx(0.05, abs=1e-6)
    assert report.scores.num_rows == 2 * score(table, write(tmp_path / "q.parquet", recorded)).scores.num_rows


def test_missing_repeated_and_unknown_sequences_are_named(table, recorded, tmp_path):
    names = list(recorded)
    rows = [(name, recorded[name]) for name in names[1:]] + [
        (names[2], recorded[names[2]]),
        ("nobody", recorded[names[0]]),
    ]
    with pytest.raises(PredictionsError) as caught:
        score(table, write(tmp_path / "predictions.parquet", rows))
    assert str(caught.value) == (
        f"{tmp_path}/predictions.parquet: expected the 15 test sequences of synthetic-adt, found 14:"
        f" missing 1 ({names[0]}), repeated 1 ({names[2]}), unknown 1 (nobody)."
        " Hand in every sequence exactly once for each sample, or name the split that the motions are of (--split,"
        " split=; test is scored) or a part of it (--limit, limit=)."
    )


def test_a_sequence_that_lacks_one_sample_is_missing(table, recorded, tmp_path):
    rows = [(name, motion) for name, motion in recorded.items() for _ in (0, 1)][:-1]
    path = write(tmp_path / "p.parquet", rows, samples=([0, 1] * 15)[:-1])
    with pytest.raises(
        PredictionsError, match=rf"each with samples 0, 1, found 14: missing 1 \({list(recorded)[-1]}\)"
    ):
        score(table, path)


def test_long_lists_of_names_are_cut(table, recorded, tmp_path):
    path = write(tmp_path / "p.parquet", dict(list(recorded.items())[:5]))
    with pytest.raises(
        PredictionsError, match=r"found 5: missing 10 \([^,]*, [^,]*, [^,]*, …\), repeated 0, unknown 0"
    ):
        score(table, path)


def test_sequences_of_the_split_beyond_the_limit_are_not_unknown(table, recorded, tmp_path):
    assert score(table, write(tmp_path / "p.parquet", recorded), limit=4).summary.sequences == 4


def test_another_length_is_refused_or_reported(table, recorded, tmp_path):
    name = list(recorded)[3]
    n = len(recorded[name])
    path = write(tmp_path / "p.parquet", recorded | {name: recorded[name][: n - 5]})
    with pytest.raises(PredictionsError, match=rf"{name}: expected {n} frames, found {n - 5}.*--allow-length-mismatch"):
        score(table, path)
    report = score(table, path, allow_length_mismatch=True)
    assert report.summary.length_mismatches == 1
    rows = [row for row in report.scores.to_pylist() if row["sequence_id"] == name]
    values = {row["metric"]: row["value"] for row in rows}
    assert values["mpjpe"] == 0.0
    expected = np.linalg.norm(recorded[name][n - 6] - recorded[name][-1], axis=-1).mean()
    assert values["goal_mpjpe"] == pytest.approx(expected, abs=1e-6)
    assert all("length_mismatch" in row["flag"] for row in rows)


def test_a_single_frame_is_refused(table, recorded, tmp_path):
    name = list(recorded)[3]
    path = write(tmp_path / "p.parquet", recorded | {name: recorded[name][:1]})
    with pytest.raises(PredictionsError, match=rf"{name}: expected 2 frames or more, found 1"):
        score(table, path, allow_length_mismatch=True)


def test_other_numbers_of_joints_are_refused(table, recorded, tmp_path):
    short = {name: motion[:, :21] for name, motion in recorded.items()}
    with pytest.raises(
        PredictionsError, match=r"column 'joints', row 0, frame 0: expected a list of frames, .*found 63 numbers"
    ):
        score(table, write(tmp_path / "p.parquet", short, kind=pa.list_(pa.list_(pa.float32()))))


@pytest.mark.parametrize("kind", [pa.large_string(), pa.string_view(), pa.dictionary(pa.int32(), pa.string())])
def test_text_as_other_libraries_write_it_is_read(table, recorded, tmp_path, kind):
    rows = pq.read_table(write(tmp_path / "p.parquet", recorded))
    pq.write_table(rows.set_column(0, "sequence_id", rows["sequence_id"].cast(kind)), tmp_path / "q.parquet")
    assert mean(score(table, tmp_path / "q.parquet"), "mpjpe") == 0.0


@pytest.mark.parametrize("part", ["", "synthetic-adt", "synthetic-adt/predictions"])
@pytest.mark.parametrize("changes", [{}, {"control": "shuffled-goal"}, {"limit": 6, "samples": 2}])
def test_a_run_scores_as_it_scored_itself(table, tmp_path, part, changes):
    run_method(request(table, tmp_path / "run", "ground-truth", **changes))
    report = score(table, tmp_path / "run" / part, out=tmp_path / "scores")
    assert report.scores.equals(read_scores(tmp_path / "run/synthetic-adt/scores.parquet"))
    for name in ("scores.parquet", "summary.json"):
        assert (tmp_path / "scores/synthetic-adt" / name).is_file()
    scored, own = (DatasetSummary.read(tmp_path / run / "synthetic-adt") for run in ("scores", "run"))
    assert scored == own


def test_what_a_run_says_otherwise_is_told(table, tmp_path):
    run_method(request(table, tmp_path / "run", "scripted"))
    assert score(table, tmp_path / "run").changed == ""
    edited = msgspec.structs.replace(DatasetSummary.read(tmp_path / "run/synthetic-adt"), recordings=99, split="train")
    edited.write(tmp_path / "run/synthetic-adt")
    changed = score(table, tmp_path / "run").changed
    assert "summary.json, split: train there, test when scored now; and 1 more" in changed


def test_a_run_that_stands_still_is_remembered_as_such(table, recorded, tmp_path):
    run_method(request(table, tmp_path / "run"))
    assert score(table, tmp_path / "run").motionless
    assert not score(table, write(tmp_path / "p.parquet", recorded)).motionless


def test_a_run_of_two_datasets_is_scored_on_the_one_given(table, tmp_path):
    other = fake_dataset(tmp_path / "other", 30, dataset="synthetic-gimo")
    run_method(request(table, tmp_path / "run", "scripted", data=(table.folder, other.folder)))
    assert score(other, tmp_path / "run").summary.dataset == "synthetic-gimo"
    assert score(table, tmp_path / "run/synthetic-adt").summary.dataset == "synthetic-adt"


def test_sequences_that_the_method_could_not_generate_are_not_missed(table, tmp_path, install):
    install("made", adapter_source(attributes="max_frames = 80"))
    own = run_method(request(table, tmp_path / "run", "made")).summaries[0]
    assert score(table, tmp_path / "run").summary == own


def test_a_run_that_was_interrupted_is_told_how_to_go_on(table, tmp_path):
    run_method(request(table, tmp_path / "run", "scripted"))
    (tmp_path / "run/synthetic-adt/predictions/part-00001.parquet").unlink()
    with pytest.raises(PredictionsError, match=r"found 11: missing 4 .* Run the same command again: it resumes\."):
        score(table, tmp_path / "run")


def test_a_run_of_another_table_is_refused(table, tmp_path):
    run_method(request(table, tmp_path / "run", "scripted"))
    other = fake_dataset(tmp_path / "other", 24)
    with pytest.raises(RunError, match=r"tables.synthetic-adt.identity_digest: the run is of table"):
        score(other, tmp_path / "run")
    stranger = fake_dataset(tmp_path / "stranger", 24, dataset="synthetic-gimo")
    with pytest.raises(RunError, match=r"the run is of synthetic-adt, not of synthetic-gimo"):
        score(stranger, tmp_path / "run")


def test_results_are_not_written_over_those_of_a_run(table, tmp_path):
    run_method(request(table, tmp_path / "run", "scripted"))
    with pytest.raises(StorageError, match=r"is a run folder with scores of its own"):
        score(table, tmp_path / "run", out=tmp_path / "run")


def test_flat_lists_are_read_and_odd_ones_refused_by_row(table, recorded, tmp_path):
    rows = {"sequence_id": list(recorded), "joints": [motion.ravel().tolist() for motion in recorded.values()]}
    pq.write_table(pa.table(rows), tmp_path / "p.parquet")
    assert mean(score(table, tmp_path / "p.parquet"), "mpjpe") == 0.0
    rows["joints"][4].pop()
    pq.write_table(pa.table(rows), tmp_path / "p.parquet")
    with pytest.raises(PredictionsError, match=r"column 'joints', row 4: expected .* all frames after one another"):
        score(table, tmp_path / "p.parquet")
