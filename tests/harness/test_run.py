"""A run from table to summary: what it writes, what it does not depend on, how it fails, and how it goes on."""

from __future__ import annotations

import errno
import json
import shutil
from pathlib import Path

import msgspec
import numpy as np
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.contract import Condition
from prbench.engine import ProcessPool
from prbench.errors import AdapterError, RunError, StorageError, UsageError
from prbench.harness import planning
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import Predictions, RunFolder, read_scores
from prbench.harness.run_folder.record import RunCost
from prbench.metrics import METRICS, METRICS_OF_MOTIONS
from prbench.protocol.manifests import load_protocol
from prbench.randomness import noise_seed
from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset
from tests.method_fixtures import adapter_source


def reproducible_bytes(folder) -> dict[str, bytes]:
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    assert not [name for name in files if "partial" in name or ".costs" in name]
    return {name: path.read_bytes() for name, path in files.items() if not name.endswith("cost.json")}


def request(table, out, method="static", **changes) -> RunRequest:
    return RunRequest(
        **{
            "method": method,
            "condition": Condition.NONE,
            "data": (table.folder,),
            "out": out,
            "batch_size": 4,
            **changes,
        }
    )


def test_static_on_a_dataset_leaves_the_run_folder_of_the_design(table, tmp_path):
    report = run_method(request(table, tmp_path / "out", samples=2, seed=5))
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"run.json", "synthetic-adt"}
    assert sorted(path.name for path in (tmp_path / "out/synthetic-adt").iterdir()) == [
        "agreement.json",
        "cost.json",
        "predictions",
        "scores.parquet",
        "summary.json",
    ]
    run = json.loads((tmp_path / "out/run.json").read_text())
    assert run["method"]["name"] == "static"
    assert run["method"]["package"] == "prbench"
    assert run["protocol_digest"] == load_protocol().digest
    assert run["tables"][0]["identity_digest"] == table.identity
    assert run["tables"][0]["content_digest"] == table.content
    assert run["tables"][0]["batch_plan"]["batches"] == 4
    assert (run["seed"], run["samples"], run["threads"], run["split"]) == (5, 2, 1, "test")
    assert report.batches_made == 4

    scores = read_scores(tmp_path / "out/synthetic-adt/scores.parquet")
    names = [info.id for info in METRICS_OF_MOTIONS]
    ids = [name for chunk in table.chunks(split="test", columns=[]) for name in chunk.sequence_ids]
    expected = [(name, sample, metric) for name in ids for sample in (0, 1) for metric in names]
    assert list(zip(*(scores[column].to_pylist() for column in ("sequence_id", "sample", "metric")))) == expected
    rates = scores.filter(np.isin(scores["metric"].to_numpy(), [m.id for m in METRICS if m.unit == "rate"]))
    assert set(rates["value"].to_pylist()) <= {0.0, 1.0}

    summary = report.summaries[0]
    assert summary.synthetic
    assert "synthetic" in summary.title
    assert (summary.sequences, summary.recordings, summary.unsupported) == (15, 3, 0)
    by_name = {metric.metric: metric for metric in summary.metrics}
    assert by_name["prime_success"].mean == 0.0
    assert by_name["prime_success"].high > 0.1  # no certainty from three recordings
    values = scores.filter(np.array(scores["metric"].to_pylist()) == "mpjpe")["value"].to_numpy()
    assert by_name["mpjpe"].mean == pytest.approx(values.mean(), abs=1e-12)


def test_nothing_personal_stands_in_the_reproducible_files(table, tmp_path):
    run_method(request(table, tmp_path / "out"))
    for name in ("run.json", "synthetic-adt/summary.json"):
        text = (tmp_path / "out" / name).read_text()
        assert str(tmp_path) not in text
        assert str(table.folder) not in text
        assert not [key for key in ("time", "host", "date", "user") if f'"{key}' in text]


def test_predictions_hold_every_sequence_and_sample_with_its_seed(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made", samples=2, seed=9))
    predictions = Predictions.open(tmp_path / "out/synthetic-adt/predictions")
    columns = ["sequence_id", "sample", "seed"]
    rows = [row for path in predictions.paths for row in pq.read_table(path, columns=columns).to_pylist()]
    assert all(row["seed"] == noise_seed(9, row["sequence_id"], row["sample"]) for row in rows)
    lengths = {name: n for c in table.chunks(split="test", columns=[]) for name, n in zip(c.sequence_ids, c.n_frames)}
    assert len(rows) == 2 * len(lengths)
    for name, n_frames in lengths.items():
        for sample in (0, 1):
            motion = predictions.motions([name], sample).values
            drawn = np.random.default_rng(noise_seed(9, name, sample)).normal(size=(200, 22, 3))
            assert len(motion) == n_frames
            assert np.array_equal(motion[0], drawn[0].astype(np.float32))


def test_the_batch_size_changes_no_score_of_a_method_that_follows_the_contract(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "one", "made", batch_size=1))
    run_method(request(table, tmp_path / "two", "made", batch_size=7))
    assert (tmp_path / "one/synthetic-adt/scores.parquet").read_bytes() == (
        tmp_path / "two/synthetic-adt/scores.parquet"
    ).read_bytes()
    assert (tmp_path / "one/run.json").read_bytes() != (tmp_path / "two/run.json").read_bytes()


def test_scores_do_not_depend_on_the_window(table, tmp_path, monkeypatch):
    run_method(request(table, tmp_path / "one", "scripted"))
    monkeypatch.setattr(planning, "WINDOW", 6)
    run_method(request(table, tmp_path / "two", "scripted"))
    assert read_scores(tmp_path / "one/synthetic-adt/scores.parquet").equals(
        read_scores(tmp_path / "two/synthetic-adt/scores.parquet")
    )


def test_several_datasets_have_a_folder_each(table, tmp_path):
    other = fake_dataset(tmp_path / "other", 30, dataset="synthetic-gimo")
    report = run_method(request(table, tmp_path / "out", data=(table.folder, other.folder)))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["run.json", "synthetic-adt", "synthetic-gimo"]
    assert [summary.dataset for summary in report.summaries] == ["synthetic-adt", "synthetic-gimo"]
    run_method(request(table, tmp_path / "single"))
    single = (tmp_path / "single/synthetic-adt/scores.parquet").read_bytes()
    assert (tmp_path / "out/synthetic-adt/scores.parquet").read_bytes() == single


def test_static_is_fitted_once_a_table(table, tmp_path, own_cache):
    run_method(request(table, tmp_path / "one"))
    (fit,) = own_cache.rglob("mean_pose.json")
    fit.write_text(json.dumps(np.full((22, 3), 0.5).tolist()))  # a refit would put it right
    run_method(request(table, tmp_path / "two"))
    assert (
        Predictions.open(tmp_path / "two/synthetic-adt/predictions").motions([ids(table)[0]], 0).values[0, 0, 0] == 0.5
    )
    run_method(request(fake_dataset(tmp_path / "other", 30), tmp_path / "three"))
    assert len(list(own_cache.rglob("mean_pose.json"))) == 2


def ids(table: SequenceTable, split: str = "test") -> list[str]:
    return [name for chunk in table.chunks(split=split, columns=[]) for name in chunk.sequence_ids]


def test_sequences_beyond_max_frames_are_counted_and_never_cut(table, tmp_path, install):
    install("made", adapter_source(attributes="max_frames = 80"))
    report = run_method(request(table, tmp_path / "out", "made"))
    lengths = [n for chunk in table.chunks(split="test", columns=[]) for n in chunk.n_frames]
    too_long = sum(n > 80 for n in lengths)
    assert 0 < too_long < 15
    assert report.summaries[0].unsupported == too_long
    assert all(metric.sequences == 15 - too_long for metric in report.summaries[0].metrics)


def test_max_frames_counts_at_the_method_s_own_rate(table, tmp_path, install):
    install("made", adapter_source(attributes="max_frames = 160\n        native_fps = 40"))
    lengths = [n for chunk in table.chunks(split="test", columns=[]) for n in chunk.n_frames]
    report = run_method(request(table, tmp_path / "out", "made"))
    assert report.summaries[0].unsupported == sum(2 * (n - 1) + 1 > 160 for n in lengths)


def test_a_method_that_can_generate_nothing_is_an_error(table, tmp_path, install):
    install("made", adapter_source(attributes="max_frames = 3"))
    with pytest.raises(AdapterError, match=r"at most 3 frames; all 15 chosen"):
        run_method(request(table, tmp_path / "out", "made"))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("joints[0, 3, 5] = np.nan", r"method 'made', sequence synthetic-adt/.*, frame 3: expected finite"),
        ("joints = joints[:, :-1]", r"method 'made', sequence synthetic-adt/.*: expected \d+ frames, found \d+"),
        ("n_frames = n_frames - 1", r"method 'made', sequence synthetic-adt/.*: expected \d+ frames, found \d+"),
        ("joints = joints[:-1]; n_frames = n_frames[:-1]", r"method 'made': expected joints of shape \(4, "),
        ("raise RuntimeError('broken')", r"method 'made' failed: RuntimeError: broken .* for the batch of 4 "),
    ],
)
def test_a_method_that_breaks_its_contract_leaves_nothing_behind(table, tmp_path, install, body, message):
    install("made", adapter_source(body=body))
    with pytest.raises(AdapterError, match=message) as caught:
        run_method(request(table, tmp_path / "out", "made"))
    assert caught.value.exit_code != 0
    assert not (tmp_path / "out").exists()


def test_the_same_error_comes_back_from_a_worker_process(table, tmp_path, install):
    install("made", adapter_source(body="joints[0, 3, 5] = np.nan"))
    with pytest.raises(AdapterError, match=r"frame 3: expected finite"):
        run_method(request(table, tmp_path / "out", "made"), engine=ProcessPool(2))
    assert not (tmp_path / "out").exists()


def test_a_failure_later_on_keeps_the_whole_batches_and_writes_no_scores(table, tmp_path, install):
    install("made", adapter_source(body="if n_frames.max() > 100: joints[0, 3, 5] = np.nan"))
    with pytest.raises(AdapterError, match=r"expected finite"):
        run_method(request(table, tmp_path / "out", "made"))
    left = {path.relative_to(tmp_path / "out/synthetic-adt").as_posix() for path in (tmp_path / "out").rglob("*/*.*")}
    assert "predictions/part-00000.parquet" in left
    assert not left & {"scores.parquet", "summary.json", "cost.json"}
    for part in (tmp_path / "out/synthetic-adt/predictions").iterdir():
        assert pq.read_table(part).num_rows == 4


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"split": "tset"}, "unknown split 'tset'"),
        ({"samples": 0}, "--samples: expected 1 or more, found 0"),
        ({"batch_size": 0}, "--batch-size"),
        ({"limit": 0}, "--limit"),
        ({"seed": -1}, "--seed"),
        ({"data": ()}, "one dataset folder or more"),
        ({"control": "shuffled"}, "unknown control 'shuffled'; beside a method there is: shuffled-goal"),
        ({"method": "scripted", "options": {"a": "b"}}, "takes neither --weights nor --option"),
    ],
)
def test_requests_that_do_not_fit_together(table, tmp_path, changes, message):
    with pytest.raises(UsageError, match=message):
        run_method(request(table, tmp_path / "out", **changes))
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("victim", ["write_table", "fsync"])
def test_a_full_disk_leaves_nothing_half_written(table, tmp_path, monkeypatch, victim):
    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    target = {"write_table": "prbench.sequences.write._PartWriter.close", "fsync": "prbench.files.storage.os.fsync"}
    monkeypatch.setattr(target[victim], full)
    with pytest.raises(StorageError, match=r"no space left on the device. Nothing half-written was kept"):
        run_method(request(table, tmp_path / "out", "scripted"))
    assert [path for path in tmp_path.rglob("*") if path.is_file() and "out" in path.parts] == []


def test_a_disk_that_is_full_when_scores_are_written_keeps_only_whole_files(table, tmp_path, monkeypatch):
    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    write = pq.ParquetWriter.write_table

    def full_for_scores(self, rows, *args, **kwargs):
        return full() if "metric" in rows.column_names else write(self, rows, *args, **kwargs)

    with monkeypatch.context() as patch:
        patch.setattr(pq.ParquetWriter, "write_table", full_for_scores)
        with pytest.raises(StorageError, match=r"no space left"):
            run_method(request(table, tmp_path / "out", "scripted"))
    assert not (tmp_path / "out/synthetic-adt/scores.parquet").exists()
    assert not list((tmp_path / "out").rglob("*partial*"))
    run_method(request(table, tmp_path / "out", "scripted"))
    run_method(request(table, tmp_path / "whole", "scripted"))
    assert (tmp_path / "out/synthetic-adt/scores.parquet").read_bytes() == (
        tmp_path / "whole/synthetic-adt/scores.parquet"
    ).read_bytes()


def test_the_default_folder_says_what_was_run_and_is_found_again(table, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = run_method(request(table, None))
    assert first.folder.path.parts[0] == "runs"
    assert first.folder.path.name.startswith("static-none-synthetic-adt-")
    assert run_method(request(table, None)).batches_made == 0
    assert run_method(request(table, None, seed=1)).folder.path != first.folder.path
    assert RunFolder.open(first.folder.path).record == first.folder.record


def test_a_run_stopped_at_any_of_its_writes_ends_with_the_same_bytes(table, tmp_path, monkeypatch):
    asked = {"method": "scripted", "limit": 4, "batch_size": 2}
    run_method(request(table, tmp_path / "whole", **asked))
    expected = reproducible_bytes(tmp_path / "whole")
    replace = Path.replace
    for stop_at in range(1, 100):
        writes = 0

        def interrupted(self, target, stop_at=stop_at):
            nonlocal writes
            writes += 1
            if writes == stop_at:
                raise KeyboardInterrupt
            replace(self, target)

        out = tmp_path / str(stop_at)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", interrupted)
            try:
                run_method(request(table, out, **asked))
            except KeyboardInterrupt:
                pass
            else:
                break
        assert not list(out.rglob("*partial*"))
        run_method(request(table, out, **asked))
        assert reproducible_bytes(out) == expected
        # run.json, two batches with their costs, scores, cost, agreement, summary; then none
    assert stop_at == 1 + 2 * 2 + 4 + 1


def test_a_finished_run_is_not_run_again(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")}
    report = run_method(request(table, tmp_path / "out", "made"))
    assert (report.batches_made, report.batches_found) == (0, 4)
    assert report.summaries[0].sequences == 15
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*")} == before


def test_a_run_of_earlier_versions_goes_on_and_is_read_where_it_lies(table, tmp_path, install, capsys):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "new", "made"))
    old = tmp_path / "old"
    shutil.copytree(tmp_path / "new/synthetic-adt", old)
    shutil.copy(tmp_path / "new/run.json", old)
    (old / "summary.json").unlink()
    (old / "predictions/part-00001.parquet").unlink()
    assert run_method(request(table, old, "made")).batches_made == 1
    assert reproducible_bytes(old) == {
        name.removeprefix("synthetic-adt/"): content for name, content in reproducible_bytes(tmp_path / "new").items()
    }
    run_method(request(table, tmp_path / "new/synthetic-adt", "made"))  # means the run that the folder is part of
    data = ("--data", str(table.folder))
    assert main(["leaderboard", "compare", str(old), str(tmp_path / "new/synthetic-adt"), *data]) == 0
    assert "made" in capsys.readouterr().out
    assert main(["score", str(old), *data, "--out", str(tmp_path / "scored")]) == 0
    assert (tmp_path / "scored/synthetic-adt/scores.parquet").read_bytes() == (old / "scores.parquet").read_bytes()


@pytest.mark.parametrize("lost", ["predictions/part-00002.parquet", "scores.parquet", "summary.json", "cost.json"])
def test_what_is_missing_is_made_again(table, tmp_path, install, lost):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    before = reproducible_bytes(tmp_path / "out")
    (tmp_path / "out/synthetic-adt" / lost).unlink()
    if lost == "predictions/part-00002.parquet":
        (tmp_path / "out/synthetic-adt/summary.json").unlink()
    run_method(request(table, tmp_path / "out", "made"))
    assert reproducible_bytes(tmp_path / "out") == before


@pytest.mark.parametrize("lost", ["scores.parquet", "summary.json"])
def test_what_was_measured_survives_the_loss_of_scores(table, tmp_path, install, lost):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    cost = (tmp_path / "out/synthetic-adt/cost.json").read_bytes()
    (tmp_path / "out/synthetic-adt" / lost).unlink()
    run_method(request(table, tmp_path / "out", "made"))
    assert (tmp_path / "out/synthetic-adt/cost.json").read_bytes() == cost


def test_damaged_scores_are_made_again(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    before = reproducible_bytes(tmp_path / "out")
    scores = tmp_path / "out/synthetic-adt/scores.parquet"
    scores.write_bytes(scores.read_bytes()[:-20])
    run_method(request(table, tmp_path / "out", "made"))
    assert reproducible_bytes(tmp_path / "out") == before


def test_a_file_that_is_no_part_of_the_plan_is_never_scored(table, tmp_path, install):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    parts = tmp_path / "out/synthetic-adt/predictions"
    (parts / "part-00099.parquet").write_bytes((parts / "part-00000.parquet").read_bytes())
    with pytest.raises(RunError, match=r"part-00099.parquet: expected the 4 parts of this run only"):
        run_method(request(table, tmp_path / "out", "made"))


@pytest.mark.parametrize("damage", ["truncated", "of another batch", "one bit"])
def test_a_damaged_part_is_made_again(table, tmp_path, install, damage):
    install("made", adapter_source())
    run_method(request(table, tmp_path / "out", "made"))
    before = reproducible_bytes(tmp_path / "out")
    (tmp_path / "out/synthetic-adt/summary.json").unlink()
    part = tmp_path / "out/synthetic-adt/predictions/part-00001.parquet"
    other = tmp_path / "out/synthetic-adt/predictions/part-00002.parquet"
    flipped = bytearray(part.read_bytes())
    flipped[len(flipped) // 2] ^= 1
    damaged = {"truncated": part.read_bytes()[:-20], "of another batch": other.read_bytes(), "one bit": bytes(flipped)}
    part.write_bytes(damaged[damage])
    untouched = [path for path in part.parent.iterdir() if path != part]
    times = [path.stat().st_mtime_ns for path in untouched]
    assert run_method(request(table, tmp_path / "out", "made")).batches_made == 1
    assert reproducible_bytes(tmp_path / "out") == before
    assert [path.stat().st_mtime_ns for path in untouched] == times


def test_the_folder_of_another_table_is_refused_although_its_name_is_the_same(table, tmp_path):
    other = fake_dataset(tmp_path / "other", 24)
    run_method(request(table, tmp_path / "out"))
    with pytest.raises(RunError, match=r"tables\.synthetic-adt\.\w+.*expected .* for this run, found"):
        run_method(request(other, tmp_path / "out"))


def test_the_folder_of_other_weights_is_refused_although_their_name_is_the_same(table, tmp_path, install):
    install("made", adapter_source())
    weights = tmp_path / "weights.pt"
    weights.write_bytes(b"one")
    run_method(request(table, tmp_path / "out", "made", weights=weights))
    weights.write_bytes(b"two")
    with pytest.raises(RunError, match=r"method\.weights_digest"):
        run_method(request(table, tmp_path / "out", "made", weights=weights))


def test_a_folder_of_weights_is_known_by_the_content_of_its_files(table, tmp_path, install):
    install("made", adapter_source())
    weights = tmp_path / "weights"
    (weights / "deep").mkdir(parents=True)
    (weights / "deep/layer.bin").write_bytes(b"one")
    run_method(request(table, tmp_path / "out", "made", weights=weights))
    (weights / "deep/layer.bin").write_bytes(b"two")
    with pytest.raises(RunError, match=r"method\.weights_digest"):
        run_method(request(table, tmp_path / "out", "made", weights=weights))


def test_cost_counts_every_batch_once_and_keeps_warm_up_apart(table, tmp_path, install):
    busy = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'sum(range(10**7))'])"
    body = f"if len(batch) > 2: raise MemoryError\n            {busy}"
    declaring = "return Motions(joints, n_frames, Cost(7))"
    install("made", adapter_source(body=body).replace("return Motions(joints, n_frames)", declaring))
    run_method(request(table, tmp_path / "out", "made", samples=2))
    cost = msgspec.json.decode((tmp_path / "out/synthetic-adt/cost.json").read_bytes(), type=RunCost)
    assert cost.motions + cost.warm_up_motions == 30
    assert cost.warm_up_motions == 8
    assert cost.seconds > 0
    assert cost.processor_seconds > 0.05, "what a child process computes counts, too"
    assert cost.warm_up_processor_seconds > 0
    assert cost.network_passes_declared == 7 * 2 * 8
    assert pq.read_table(tmp_path / "out/synthetic-adt/predictions").num_rows == 30
