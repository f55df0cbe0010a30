"""A run in shards, merged, has the bytes of a run in one go."""

from __future__ import annotations

import shutil
import uuid
from pathlib import Path

import pytest

from prbench.engine.shards import Shard, require_whole
from prbench.errors import AdapterError, PrbenchError, RunError, ShardError, StorageError
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder
from prbench.harness.sharded import merge_run_shards, run_shard
from prbench.object_stores.outputs import written_folder
from prbench.sequences import SequenceTable
from tests.fakes import fake_dataset
from tests.harness.test_run import reproducible_bytes, request
from tests.method_fixtures import adapter_source


def run_bytes(folder: Path) -> dict[str, bytes]:
    """What must be the same, of runs on several tables, too."""
    return {name: content for name, content in reproducible_bytes(folder).items() if not name.endswith("cost.json")}


def make_shards(folder: Path, count: int, asked) -> list[Path]:
    """Make all shards; ``asked`` gives the request for a folder."""
    folders = [folder / f"shard-{number}" for number in range(1, count + 1)]
    for number, out in enumerate(folders, start=1):
        run_shard(asked(out), Shard(number, count))
    return folders


def merged(folders: list[Path], out: Path, **settings) -> Path:
    merge_run_shards(require_whole(folders), out, **settings)
    return out


def test_a_merge_needs_no_method_and_finds_the_table_where_it_is_named(table, tmp_path, install, monkeypatch):
    install("made", adapter_source())
    moved = tmp_path / "moved"
    shutil.copytree(table.folder, tmp_path / "table")

    def asked(out):
        return request(table, out, "made", data=(tmp_path / "table",))

    folders = make_shards(tmp_path, 2, asked)
    (tmp_path / "table").rename(moved)
    (tmp_path / "site" / "prbench_made.py").write_text("raise RuntimeError('not on this machine')")
    with pytest.raises(PrbenchError, match="expected a built dataset"):
        merged(folders, tmp_path / "merged")
    merged(folders, tmp_path / "merged", data=(moved,))
    assert RunFolder.open(tmp_path / "merged").record.method.name == "made"
    other = fake_dataset(tmp_path / "other", 30)
    with pytest.raises(ShardError, match=r"digest: expected .*, found .*Name the tables of the shards with --data"):
        merged(folders, tmp_path / "another", data=(other.folder,))


def test_shards_of_other_weights_or_another_table_are_named(table, tmp_path):
    other = fake_dataset(tmp_path / "other", 30)
    run_shard(request(table, tmp_path / "shard-1"), Shard(1, 2))
    run_shard(request(other, tmp_path / "shard-2"), Shard(2, 2))
    with pytest.raises(ShardError, match=r"shard-2.shard.json, tables.synthetic-adt.identity_digest: expected"):
        merged([tmp_path / "shard-1", tmp_path / "shard-2"], tmp_path / "merged")
    run_shard(request(table, tmp_path / "shard-3"), Shard(2, 2))
    record = (tmp_path / "shard-3" / "shard.json").read_text()
    changed = record.replace('"weights_digest": null', f'"weights_digest": "{"a" * 64}"')
    (tmp_path / "shard-3" / "shard.json").write_text(changed)
    with pytest.raises(ShardError, match=r"method.weights_digest: expected nothing, found aaaaaaaaaaaa…"):
        merged([tmp_path / "shard-1", tmp_path / "shard-3"], tmp_path / "merged")


def test_a_shard_that_was_interrupted_goes_on_and_is_not_merged_before(table, tmp_path, install):
    install("made", adapter_source())

    def stop(step):
        if step.done == 1:
            raise KeyboardInterrupt

    run_method(request(table, tmp_path / "whole", "made"))
    one, two = tmp_path / "one", tmp_path / "two"
    run_shard(request(table, one, "made"), Shard(1, 2))
    with pytest.raises(KeyboardInterrupt):
        run_shard(request(table, two, "made"), Shard(2, 2), progress=stop)
    with pytest.raises(ShardError, match=r"two: shard 2/2 is not finished: expected part-0000\d.parquet of synthetic"):
        merged([one, two], tmp_path / "merged")
    assert not (tmp_path / "merged").exists()
    report = run_shard(request(table, two, "made"), Shard(2, 2))
    assert (report.batches_found, report.batches_made, report.planned) == (1, 1, 4)
    assert run_bytes(merged([one, two], tmp_path / "merged")) == run_bytes(tmp_path / "whole")


def test_a_damaged_batch_is_named_and_the_merge_goes_on_when_it_is_mended(table, tmp_path):
    run_method(request(table, tmp_path / "whole"))
    folders = make_shards(tmp_path, 2, lambda out: request(table, out))
    part = folders[1] / "synthetic-adt/predictions" / "part-00002.parquet"
    part.write_bytes(part.read_bytes()[:-20])
    with pytest.raises(ShardError, match=r"part-00002.parquet: expected a whole batch of shard 2/2, found a damaged"):
        merged(folders, tmp_path / "merged")
    assert not (tmp_path / "merged" / "synthetic-adt/scores.parquet").exists()
    run_shard(request(table, folders[1]), Shard(2, 2))
    report = merge_run_shards(require_whole(folders), tmp_path / "merged")
    assert report.batches_found == 2
    assert run_bytes(tmp_path / "merged") == run_bytes(tmp_path / "whole")


def test_a_shards_folder_is_no_run_and_a_runs_folder_no_shard(table, tmp_path):
    run_shard(request(table, tmp_path / "shard"), Shard(1, 2))
    with pytest.raises(StorageError, match=r"holds no run.json"):
        run_method(request(table, tmp_path / "shard"))
    with pytest.raises(RunError, match=r"shard: is a shard of a run; `prbench merge` puts all of them together"):
        RunFolder.open(tmp_path / "shard")
    with pytest.raises(ShardError, match="shard: expected 2/2, found 1/2"):
        run_shard(request(table, tmp_path / "shard"), Shard(2, 2))
    run_method(request(table, tmp_path / "run"))
    with pytest.raises(StorageError, match=r"holds no shard.json"):
        run_shard(request(table, tmp_path / "run"), Shard(1, 2))
    merged_from = require_whole([tmp_path / "shard", _second(table, tmp_path)])
    with pytest.raises(StorageError, match=r"holds no run.json"):
        merge_run_shards(merged_from, tmp_path / "shard")


def _second(table, tmp_path) -> Path:
    run_shard(request(table, tmp_path / "second"), Shard(2, 2))
    return tmp_path / "second"


def test_a_shard_whose_first_batch_fails_leaves_nothing(table, tmp_path, install):
    install("made", adapter_source(body="raise ValueError('no')"))
    with pytest.raises(AdapterError):
        run_shard(request(table, tmp_path / "shard", "made"), Shard(1, 2))
    assert not (tmp_path / "shard").exists()


def test_a_merge_finds_a_table_at_the_url_that_its_shards_name(table, tmp_path, monkeypatch):
    pytest.importorskip("fsspec")
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    url = f"memory://tables-{uuid.uuid4().hex}/table"
    moved = tmp_path / "moved"
    shutil.copytree(table.folder, moved)
    with written_folder(url) as (folder, _):
        shutil.copytree(table.folder, folder, dirs_exist_ok=True)
    run_method(request(SequenceTable.open(moved), tmp_path / "whole", "ground-truth"))
    run_shard(request(SequenceTable.open(moved), tmp_path / "shard", "ground-truth"), Shard(1, 1), tables_at=[url])
    shutil.rmtree(moved)
    assert run_bytes(merged([tmp_path / "shard"], tmp_path / "merged")) == run_bytes(tmp_path / "whole")


def test_a_shard_finds_a_folder_of_its_own(table, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reports = [run_shard(request(table, None), Shard(number, 2)) for number in (1, 2)]
    assert [report.folder.name.rpartition("-shard-")[2] for report in reports] == ["1-of-2", "2-of-2"]
