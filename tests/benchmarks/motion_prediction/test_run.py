"""Runs of motion prediction: the folder, resuming, conditions, refusals, and what a predictor may see."""

from __future__ import annotations

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import AdapterError, PrbenchError, RunError, UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.request import RunRequest
from prbench.harness.run import RunReport, run_method
from prbench.harness.run_folder import RunFolder, read_scores
from prbench_benchmarks.motion_prediction.batch import Condition
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol
from prbench_benchmarks.motion_prediction.scoring import SimilarPasts, score_predictor
from prbench_benchmarks.motion_prediction.table import WindowsTable
from tests.benchmarks.motion_prediction.windows import walking, write
from tests.harness.test_run import reproducible_bytes

BENCHMARK = load_benchmark("motion-prediction")

PROGRAM = r"""
import json, sys
import pyarrow as pa

def answer(header, payload=b""):
    if payload:
        header["bytes"] = len(payload)
    sys.stdout.buffer.write(json.dumps(header).encode() + b"\n" + payload)
    sys.stdout.buffer.flush()

for line in iter(sys.stdin.buffer.readline, b""):
    asked = json.loads(line)
    if asked["message"] == "hello":
        assert asked["benchmark"] == "motion-prediction"
        answer({"message": "hello", "wire": 1, "name": "stays", "version": "1", "conditions": ["pose", "pose+gaze"]})
        continue
    rows = pa.ipc.open_stream(sys.stdin.buffer.read(asked["bytes"])).read_next_batch()
    per_pose = 3 * len(asked["joint_names"])
    last = [row[-per_pose:] for row in rows["observed_joints"].to_pylist()]
    joints = [pose * (asked["n_future"] * asked["n_samples"]) for pose in last]
    batch = pa.record_batch([rows["opaque_id"], pa.array(joints, pa.list_(pa.float32()))], ["opaque_id", "joints"])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batch.schema) as writer:
        writer.write_batch(batch)
    answer({"message": "futures", "batch": asked["batch"]}, sink.getvalue().to_pybytes())
"""

NOISE = """
    import numpy as np
    from prbench_benchmarks.motion_prediction.batch import Condition, Futures, sample_generator

    class Noise:
        name = "noise"
        conditions = frozenset(Condition)

        def predict(self, batch, *, n_samples, seed):
            shape = (batch.n_future, len(batch.joint_names), 3)
            draws = [
                [sample_generator(seed, key, k).normal(size=shape) for k in range(n_samples)] for key in batch.key
            ]
            last = batch.observed_joints[:, None, -1:]
            {body}
            return Futures(joints=(last + np.array(draws)).astype(np.float32))

    def load(weights, *, options, device):
        return Noise()
"""


@pytest.fixture(scope="module")
def windows(tmp_path_factory) -> Path:
    """Nine windows of two test recordings, and five of a training recording."""
    folder = tmp_path_factory.mktemp("windows") / "table"
    return write(folder, walking("a", 150), walking("b", 135, number=2), walking("c", 150, split="train", number=1))


@pytest.fixture
def predictor(tmp_path, install):
    """Install a predictor of another package; ``body`` runs before it answers."""

    def _install(name: str, body: str = "") -> None:
        install(name, NOISE.format(body=body).replace('"noise"', f'"{name}"'))
        metadata = next((tmp_path / "site").glob(f"prbench_{name}-*/entry_points.txt"))
        metadata.write_text(metadata.read_text().replace("prbench.adapters", "prbench.predictors"))

    return _install


def asked(windows: Path, out: Path, method: str = "constant-velocity", **changes) -> RunRequest:
    """A small run."""
    wanted = {"condition": "pose", "samples": 2, "batch_size": 2}
    return RunRequest(benchmark=BENCHMARK.name, method=method, data=(windows,), out=out, **{**wanted, **changes})


def run(*arguments, **changes) -> RunReport:
    return run_method(asked(*arguments, **changes))


def means(report: RunReport) -> dict[str, float]:
    return {metric.metric: metric.mean for metric in report.summaries[0].metrics}


def test_a_run_scores_as_the_functions_of_motion_prediction_do(windows, tmp_path):
    report = run(windows, tmp_path / "out")
    table = WindowsTable.open(windows)
    chosen = table.chosen(split="test")
    rules = load_prediction_protocol().evaluation
    similar = SimilarPasts.of(table, chosen, closer_than=rules.similar_past)
    scores = score_predictor(ConstantVelocity(), table, Condition.POSE, chosen, similar=similar, n_samples=2)
    expected = scores.means()
    found = report.summaries[0]
    assert {metric.metric for metric in found.metrics} == set(expected)
    for metric in found.metrics:
        assert metric.mean == pytest.approx(expected[metric.metric], abs=1e-6)
    assert (found.sequences, found.recordings) == (len(chosen), 2)


def test_every_score_has_a_place_in_tables():
    assert [info.id for info in BENCHMARK.ranked_metrics] == ["ade", "fde", "mmade", "mmfde", "wrist_to_goal"]
    positions = [info.position for info in BENCHMARK.metrics]
    assert positions == sorted(set(positions))


def test_the_record_names_the_benchmark_and_its_protocol(windows, tmp_path):
    report = run(windows, tmp_path / "out")
    record = RunFolder.open(tmp_path / "out", any_benchmark=True).record
    assert record == report.folder.record
    assert record.benchmark == "motion-prediction"
    assert record.protocol_digest == load_prediction_protocol().digest
    assert record.method.origin == "built in"


def test_a_run_goes_on_where_it_was_stopped_and_ends_with_the_same_bytes(windows, tmp_path, predictor):
    predictor("noise")
    run(windows, tmp_path / "whole", "noise")
    shutil.copytree(tmp_path / "whole", tmp_path / "part")
    for name in ("predictions/part-00001.parquet", "scores.parquet", "summary.json", "cost.json"):
        (tmp_path / "part/synthetic-walks" / name).unlink()
    report = run(windows, tmp_path / "part", "noise")
    assert (report.batches_made, report.batches_found) == (1, 4)
    assert reproducible_bytes(tmp_path / "part") == reproducible_bytes(tmp_path / "whole")


def test_neither_batches_nor_order_change_what_is_predicted(windows, tmp_path, predictor):
    predictor("noise")
    one = means(run(windows, tmp_path / "one", "noise", batch_size=1))
    all_at_once = means(run(windows, tmp_path / "all", "noise", batch_size=64))
    assert one == pytest.approx(all_at_once, abs=1e-9)


def test_fewer_samples_are_a_prefix_of_more(windows, tmp_path, predictor):
    predictor("noise")
    five = means(run(windows, tmp_path / "five", "noise", samples=5))
    six = means(run(windows, tmp_path / "six", "noise", samples=6))
    assert five["ade"] == five["ade@k5"] == six["ade@k5"]
    assert six["ade"] <= five["ade"]


@pytest.mark.parametrize("isolate", [False, True])
def test_samples_of_one_design_have_no_scores_of_fewer(windows, tmp_path, predictor, isolate):
    predictor("drawn")
    predictor("designed")
    module = next((tmp_path / "site").glob("*designed*.py"))
    module.write_text(module.read_text().replace("class Noise:", "class Noise:\n    one_design = True"))
    drawn = run(windows, tmp_path / "drawn", "drawn", samples=5)
    designed = run(windows, tmp_path / "designed", "designed", samples=5, isolate=isolate)
    assert set(means(drawn)) - set(means(designed)) == {"ade@k1", "fde@k1"}
    assert means(designed)["ade@k5"] == means(designed)["ade"]
    methods = [json.loads((tmp_path / name / "run.json").read_text())["method"] for name in ("drawn", "designed")]
    assert "one_design" not in methods[0]
    assert methods[1]["one_design"] is True


def test_the_nearest_past_learns_from_the_training_split(windows, tmp_path):
    report = run(windows, tmp_path / "out", "nearest-past", condition="pose+gaze")
    assert means(report)["apd"] > 0
    with pytest.raises(UsageError, match="at most 5 samples, found 6"):
        run(windows, tmp_path / "more", "nearest-past", samples=6)


def test_an_isolated_predictor_learns_from_a_copy_and_scores_as_here(windows, tmp_path):
    here = run(windows, tmp_path / "here", "nearest-past", condition="pose+gaze")
    apart = run(windows, tmp_path / "apart", "nearest-past", condition="pose+gaze", isolate=True)
    assert means(apart) == means(here)
    assert apart.folder.record.method.isolation in ("process", "bubblewrap")
    split = {"split": "train", "isolate": True}  # it may be run on what it learns from, as in this process
    assert means(run(windows, tmp_path / "train", "nearest-past", **split))["ade"] == pytest.approx(0, abs=1e-5)


SEARCH = """
    import json
    from prbench_benchmarks.motion_prediction.batch import Condition
    from prbench_benchmarks.motion_prediction.table import WindowsTable

    class Searching:
        name = "searching"
        conditions = frozenset(Condition)

        def fit(self, train):
            table = WindowsTable.open(train.folder)
            learnt = [name for _, truth in train.batches(Condition.POSE_GAZE) for name in truth.window_ids]
            held = [[run.run_id, len(run)] for _, run in table.iterate_runs()]
            self.found = [held, table.windows["window_id"].to_pylist(), learnt]

        def predict(self, batch, *, n_samples, seed):
            raise ValueError(json.dumps(self.found))

    def load(weights, *, options, device):
        return Searching()
"""


@pytest.mark.parametrize(("split", "learnt"), [("test", "c"), ("published", "d")])
def test_an_isolated_predictor_finds_no_window_of_another_split(tmp_path, install, split, learnt):
    published = {"a": "test", "b": "test", "c": "test", "d": "train", "e": "unused"}
    runs = [
        replace(walking(name, 150, split="train" if name == "c" else "test", number=n), published_split=published[name])
        for n, name in enumerate(published)
    ]
    folder = write(tmp_path / "table", *runs)
    install("searching", SEARCH)
    metadata = next((tmp_path / "site").glob("prbench_searching-*/entry_points.txt"))
    metadata.write_text(metadata.read_text().replace("prbench.adapters", "prbench.predictors"))

    def found(*, isolate: bool) -> list[list]:
        with pytest.raises(AdapterError) as told:
            run(folder, tmp_path / "out", "searching", split=split, condition="pose+gaze", isolate=isolate)
        said = re.search(r"\[\[\[.*\]\]", str(told.value))
        assert said is not None
        return json.loads(said[0])

    held, windows, shown = found(isolate=True)
    assert held == [[f"{learnt}/0", 150]]
    assert windows == shown == [f"{learnt}/0/sliding/{15 * n}" for n in range(5)]
    everything, _, shown_here = found(isolate=False)
    assert len(everything) == 5
    assert shown_here == shown


def test_an_isolated_predictor_without_training_windows_is_refused(tmp_path):
    folder = write(tmp_path / "table", walking("a", 150))
    with pytest.raises(UsageError, match=r"no window of 5 is left \(split train"):
        run(folder, tmp_path / "out", "nearest-past", isolate=True)
    assert not (tmp_path / "out").exists()


def test_an_answer_with_nan_is_refused_and_leaves_nothing_behind(windows, tmp_path, predictor):
    predictor("noise", body="draws[0][0][0] = np.nan")
    with pytest.raises(AdapterError, match="found NaN or infinity"):
        run(windows, tmp_path / "out", "noise")
    assert not (tmp_path / "out").exists()


def test_a_failure_names_method_and_windows(windows, tmp_path, predictor):
    predictor("noise", body="raise RuntimeError('no luck')")
    with pytest.raises(AdapterError, match=r"method 'noise' failed: RuntimeError: no luck .* windows from a/0"):
        run(windows, tmp_path / "out", "noise")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"condition": "text"}, "expected one of the benchmark motion-prediction: pose"),
        ({"method": "ground-truth", "condition": None}, "--method ground-truth: the benchmark motion-prediction"),
        ({"control": "shuffled-goal"}, "--control"),
        ({"method": "mdm"}, "'mdm' is a method of the benchmark prime-and-reach"),
        ({"method": "nearest-pest"}, "'nearest-pest' is not installed"),
        ({"split": "published"}, "no window"),
        ({"sequences": ("nowhere",)}, "nowhere"),
    ],
)
def test_what_motion_prediction_does_not_have_is_refused(windows, tmp_path, changes, message):
    changes = {"method": "zero-velocity", **changes}
    with pytest.raises(PrbenchError, match=message):
        run(windows, tmp_path / "out", **changes)
    assert not (tmp_path / "out").exists()


def test_a_table_of_sequences_is_no_table_of_windows(table, tmp_path):
    with pytest.raises(PrbenchError, match=r"windows\.json"):
        run(table.folder, tmp_path / "out")


@pytest.mark.parametrize("condition", ["pose", "pose+gaze"])
def test_a_program_over_arrow_scores_as_the_same_predictor_here(windows, tmp_path, condition):
    program = tmp_path / "stays.py"
    program.write_text(PROGRAM)
    report = run(windows, tmp_path / "apart", f'cmd:"{sys.executable}" {program}', condition=condition)
    here = run(windows, tmp_path / "here", "zero-velocity", condition=condition)
    assert means(report) == means(here)
    assert report.folder.record.method.kind == "program"


@pytest.mark.parametrize("condition", ["pose", "pose+gaze"])
def test_an_isolated_predictor_scores_as_here(windows, tmp_path, predictor, condition):
    predictor("noise")
    apart = run(windows, tmp_path / "apart", "noise", condition=condition, isolate=True)
    here = run(windows, tmp_path / "here", "noise", condition=condition)
    assert means(apart) == means(here)
    assert apart.folder.record.method.isolation in ("process", "bubblewrap")


def test_a_program_that_answers_too_few_numbers_is_told(windows, tmp_path):
    program = tmp_path / "stays.py"
    program.write_text(PROGRAM.replace(' * asked["n_samples"]', ""))
    with pytest.raises(AdapterError, match=r"sent futures that cannot be used: expected 7,920 numbers in 'joints'"):
        run(windows, tmp_path / "out", f'cmd:"{sys.executable}" {program}')


def test_single_windows_can_be_run(windows, tmp_path):
    report = run(windows, tmp_path / "out", sequences=("a/0/sliding/15", "b/0/sliding/0"))
    assert report.folder.record.sequences == ("a/0/sliding/15", "b/0/sliding/0")
    assert report.summaries[0].sequences == 2


def test_scores_that_were_edited_are_refused(windows, tmp_path):
    run(windows, tmp_path / "out")
    path = tmp_path / "out" / "synthetic-walks/scores.parquet"
    shutil.copy(path, tmp_path / "kept.parquet")
    run(windows, tmp_path / "other", "zero-velocity")
    shutil.copy(tmp_path / "other" / "synthetic-walks/scores.parquet", path)
    with pytest.raises(RunError, match=r"scores\.parquet, row"):
        run(windows, tmp_path / "out")


def test_commands_of_prime_and_reach_refuse_its_runs(windows, tmp_path):
    run(windows, tmp_path / "out")
    with pytest.raises(RunError, match=r"a run of the benchmark motion-prediction, which this command does not know"):
        RunFolder.open(tmp_path / "out")


def test_ids_of_windows_tell_their_recording():
    assert BENCHMARK.recording_key("p7_1/place-3/sliding/45") == "p7_1"
    assert BENCHMARK.recording_key("adt/tour/M1292/123/pick/5/suit/event-0.5/12") == "adt/tour/M1292"


def test_windows_without_a_score_have_no_row(windows, tmp_path):
    run(windows, tmp_path / "out")
    scores = read_scores(tmp_path / "out" / "synthetic-walks/scores.parquet")
    assert "wrist_to_goal" not in set(scores["metric"].to_pylist()), "sliding windows have no goal"
    assert np.isfinite(scores["value"].to_numpy()).all()
