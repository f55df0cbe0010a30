from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.engine import shards
from prbench.engine.shards import FILE_NAME, Shard, ShardRecord, begin_shard, require_whole
from prbench.errors import ShardError, UsageError
from prbench.harness.run_folder import RunRecord


def made(folder: Path, number: int = 1, count: int = 3, **changes) -> Path:
    values = {"kind": "dataset", "settings": {"dataset": "adt", "options": {"limit": None}}, "plan": ("a", "b", "c")}
    folder.mkdir()
    ShardRecord(number=number, count=count, **values | changes).write(folder)
    return folder


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "a/b", "1/", "/2", "-1/2", "1/2/3", "٣/٤", "1/99999999"])
def test_a_text_that_names_no_shard_is_refused(text):
    with pytest.raises(UsageError, match="expected K/N with K from 1 to N, such as 3/16"):
        Shard.parse(text)


def test_a_shard_is_written_as_it_is_read():
    assert str(Shard.parse("3/16")) == "3/16"


@pytest.mark.parametrize("items", [0, 1, 2, 5, 16, 17, 100])
@pytest.mark.parametrize("count", [1, 2, 3, 7, 16, 40])
def test_every_item_is_in_exactly_one_shard_and_shards_are_alike(items, count):
    dealt = [Shard(number, count).places(items) for number in range(1, count + 1)]
    assert sorted(place for places in dealt for place in places) == list(range(items))
    assert all(places == sorted(places) for places in dealt)
    sizes = [len(places) for places in dealt]
    assert max(sizes) - min(sizes) <= 1


def test_items_are_dealt_back_and_forth_so_that_no_shard_gets_the_largest_of_every_round():
    assert [Shard(number, 3).places(9) for number in (1, 2, 3)] == [[0, 5, 6], [1, 4, 7], [2, 3, 8]]


def test_shards_come_in_their_order(tmp_path):
    folders = [made(tmp_path / name, number) for name, number in (("z", 2), ("y", 3), ("x", 1))]
    assert [folder.name for folder, _ in require_whole(folders)] == ["x", "z", "y"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"number": 1}, r"b: is shard 1/3, and so is .*a. Name each shard once"),
        ({"count": 4}, r"b.shard.json, number of shards: expected 3, found 4, unlike .*a\."),
        ({"kind": "run"}, "kind: expected dataset, found run"),
        ({"settings": {"dataset": "gimo", "options": {"limit": None}}}, "dataset: expected adt, found gimo"),
        ({"settings": {"dataset": "adt", "options": {"limit": 3}}}, "options.limit: expected nothing, found 3"),
        ({"prbench_version": "0.1.0"}, "prbench_version: expected .*, found 0.1.0"),
        ({"code_digest": "f" * 64}, r"code_digest: expected .{12}…, found f{12}…"),
        ({"plan": ("a", "b")}, "plan: expected 3 items, found 2, without 'c'"),
        ({"plan": ("a", "b", "c", "d")}, "plan: expected 3 items, found 4, with 'd'"),
        ({"plan": ("b", "a", "c")}, "plan: expected 3 items, found 3 in another order"),
    ],
)
def test_an_overlapping_or_foreign_shard_is_named_with_what_differs(tmp_path, changes, message):
    folders = [made(tmp_path / "a"), made(tmp_path / "b", **{"number": 2} | changes), made(tmp_path / "c", 3)]
    with pytest.raises(ShardError, match=message):
        require_whole(folders)


def test_missing_shards_are_named(tmp_path):
    with pytest.raises(ShardError, match=r"expected all 12 shards, found 2: 1/12, 3/12, .* and 2 more missing"):
        require_whole([made(tmp_path / "a", 2, 12), made(tmp_path / "b", 4, 12)])


def test_shards_of_another_prbench_are_not_merged_by_this_one(tmp_path, monkeypatch):
    folder = made(tmp_path / "a", 1, 1)
    monkeypatch.setattr(shards, "code_digest", lambda: "0" * 64)
    with pytest.raises(ShardError, match="Merge them with the prbench that made them"):
        require_whole([folder])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, r"expected a shard \(a folder with shard.json, from --shard K/N\), found no such file"),
        ("{", "not a valid shard.json"),
        ({"schema_version": 2}, "schema_version: expected 1, found 2"),
        ({"number": 4}, "expected a shard K/N with K from 1 to N, found 4/3"),
        ({"more": 1}, "unknown field"),
    ],
)
def test_a_folder_that_is_no_shard_is_named(tmp_path, content, message):
    path = made(tmp_path / "a") / FILE_NAME
    if isinstance(content, dict):
        path.write_text(json.dumps(json.loads(path.read_text()) | content))
    elif content is not None:
        path.write_text(content)
    else:
        path.unlink()
    with pytest.raises(ShardError, match=message):
        require_whole([tmp_path / "a"])


@pytest.mark.parametrize(("kind", "name"), [(int, "dataset"), (str, "corpus"), (RunRecord, "")])
def test_settings_that_are_none_of_a_shard_are_named(tmp_path, kind, name):
    record = ShardRecord.read(made(tmp_path / "a"))
    with pytest.raises(ShardError, match=rf"shard\.json, settings{name and '.' + name}: expected those of a dataset"):
        record.setting(tmp_path / "a", kind, name)


def test_a_folder_goes_on_with_its_own_shard_alone(tmp_path):
    folder = made(tmp_path / "a", 2)
    record = ShardRecord.read(folder)
    begin_shard(folder, record)
    for other, message in (
        (ShardRecord(kind=record.kind, number=3, count=3, settings=record.settings, plan=record.plan), "shard: exp"),
        (ShardRecord(kind=record.kind, number=2, count=3, settings={"dataset": "x"}, plan=record.plan), "dataset: exp"),
    ):
        with pytest.raises(ShardError, match=f"{message}.*The folder belongs to another shard"):
            begin_shard(folder, other)
    assert ShardRecord.read(folder) == record
