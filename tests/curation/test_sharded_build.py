"""A build in shards, merged, has the bytes of a build in one go."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.curation import BuildOptions, CurationOptions, build_from_sources
from prbench.curation.build import build_shard_from_sources, merge_dataset_shards
from prbench.engine.shards import Shard, require_whole
from prbench.errors import RecordingsWouldBeLost, ShardError, StorageError
from tests.curation.sources import SceneSource, folder_bytes, some_sources


def make_shards(folder: Path, sources, count: int, **settings) -> list[Path]:
    folders = [folder / f"shard-{number}" for number in range(1, count + 1)]
    for number, out in enumerate(folders, start=1):
        build_shard_from_sources(sources, out, Shard(number, count), **settings)
    return folders


def merged(folders: list[Path], out: Path, *, replace: bool = False) -> Path:
    merge_dataset_shards(require_whole(folders), out, replace=replace)
    return out


def test_a_shard_that_was_interrupted_goes_on(tmp_path):
    class Interrupted(Exception):
        pass

    def stop(*step) -> None:
        raise Interrupted

    build_from_sources(some_sources(5), tmp_path / "whole")
    folders = make_shards(tmp_path, some_sources(5), 2)
    again = tmp_path / "again"
    with pytest.raises(Interrupted):
        build_shard_from_sources(some_sources(5), again, Shard(1, 2), progress=stop)
    with pytest.raises(ShardError, match=r"again: shard 1/2 is not finished. Run its command \(--shard 1/2\) again"):
        merged([again, folders[1]], tmp_path / "early")
    assert not (tmp_path / "early").exists()
    assert build_shard_from_sources(some_sources(5), again, Shard(1, 2)).reused == 1
    assert folder_bytes(again) == folder_bytes(folders[0])
    assert folder_bytes(merged([again, folders[1]], tmp_path / "merged")) == folder_bytes(tmp_path / "whole")


def test_what_failed_is_tried_again_and_what_changed_is_made_anew(tmp_path):
    broken = [SceneSource("a", problem="file"), SceneSource("b", version=1)]
    build_shard_from_sources(broken, tmp_path / "shard", Shard(1, 1))
    mended = [SceneSource("a"), SceneSource("b", version=2)]
    assert build_shard_from_sources(mended, tmp_path / "shard", Shard(1, 1)).reused == 0
    build_from_sources(mended, tmp_path / "whole")
    assert len(list((tmp_path / "shard" / "parts").iterdir())) == 2
    assert folder_bytes(merged([tmp_path / "shard"], tmp_path / "merged")) == folder_bytes(tmp_path / "whole")


def test_a_folder_of_something_else_is_no_shard(tmp_path):
    build_from_sources(some_sources(1), tmp_path / "table")
    with pytest.raises(StorageError, match=r"holds no shard.json, so it is no shard"):
        build_shard_from_sources(some_sources(1), tmp_path / "table", Shard(1, 1))
    build_shard_from_sources(some_sources(2), tmp_path / "shard", Shard(1, 2))
    with pytest.raises(ShardError, match="shard: expected 2/2, found 1/2"):
        build_shard_from_sources(some_sources(2), tmp_path / "shard", Shard(2, 2))
    with pytest.raises(StorageError, match=r"holds no dataset.json"):
        build_from_sources(some_sources(2), tmp_path / "shard")


def test_nodes_that_see_other_recordings_are_named(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    build_shard_from_sources(some_sources(3), one, Shard(1, 2))
    build_shard_from_sources(some_sources(2), two, Shard(2, 2))
    with pytest.raises(ShardError, match=r"two.shard.json, plan: expected 3 items, found 2, without 'room_2'"):
        merged([one, two], tmp_path / "merged")


def test_nodes_with_other_options_are_named(tmp_path):
    one, two = tmp_path / "one", tmp_path / "two"
    build_shard_from_sources(some_sources(2), one, Shard(1, 2))
    options = BuildOptions(CurationOptions(in_hand="wrist"))
    build_shard_from_sources(some_sources(2), two, Shard(2, 2), options=options)
    with pytest.raises(ShardError, match=r"options.curation.in_hand: expected nothing, found wrist, unlike .*one"):
        merged([one, two], tmp_path / "merged")


@pytest.mark.parametrize("damage", ["truncated", "one bit", "gone"])
def test_a_damaged_file_of_a_shard_is_named(tmp_path, damage):
    folders = make_shards(tmp_path, some_sources(2), 2)
    file = next((folders[1] / "parts").glob("*/sequences.arrow"))
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    if damage == "gone":
        file.unlink()
    else:
        file.write_bytes(bytes(content) if damage == "one bit" else file.read_bytes()[:-9])
    with pytest.raises(ShardError, match=r"sequences.arrow: expected the file that shard 2/2 has written"):
        merged(folders, tmp_path / "merged")
    assert not (tmp_path / "merged").exists()


def test_a_list_of_parts_that_is_not_the_shards_is_refused(tmp_path):
    one, two = make_shards(tmp_path, some_sources(4), 2)
    (two / "finished.json").write_bytes((one / "finished.json").read_bytes())
    with pytest.raises(ShardError, match="does not list the parts of shard 2/2"):
        merged([one, two], tmp_path / "merged")


def test_a_merge_never_replaces_a_table_by_less(tmp_path):
    build_from_sources(some_sources(3), tmp_path / "table")
    before = folder_bytes(tmp_path / "table")
    folders = make_shards(tmp_path, some_sources(2), 2)
    with pytest.raises(RecordingsWouldBeLost, match="room_2"):
        merged(folders, tmp_path / "table")
    assert folder_bytes(tmp_path / "table") == before
    merged(folders, tmp_path / "table", replace=True)
    assert folder_bytes(tmp_path / "table") != before
