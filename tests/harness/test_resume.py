"""A run that was interrupted ends like one that was not; a folder of another run is refused."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import pyarrow.parquet as pq
import pytest

from prbench.cli.main import main
from prbench.errors import RunError
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import RunCost
from tests.fakes import fake_dataset
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source


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
    body = "if len(batch) > 2: raise MemoryError"
    declaring = "return Motions(joints, n_frames, Cost(7))"
    install("made", adapter_source(body=body).replace("return Motions(joints, n_frames)", declaring))
    run_method(request(table, tmp_path / "out", "made", samples=2))
    cost = msgspec.json.decode((tmp_path / "out/synthetic-adt/cost.json").read_bytes(), type=RunCost)
    assert cost.motions + cost.warm_up_motions == 30
    assert cost.warm_up_motions == 8
    assert cost.seconds > 0
    assert cost.network_passes_declared == 7 * 2 * 8
    assert pq.read_table(tmp_path / "out/synthetic-adt/predictions").num_rows == 30
