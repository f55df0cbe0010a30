"""What was parsed is taken from the cache, until anything about the file changes."""

from __future__ import annotations

import os
import shutil
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest

from prbench.errors import UsageError
from prbench.files.storage import file_digest
from prbench.readers import parse_cache
from prbench.readers.aria_mps import format as mps
from prbench.readers.aria_mps import trajectory
from prbench.readers.aria_mps.search import NearGaze
from prbench.readers.aria_mps.trajectory import read_near
from prbench.readers.files import ZippedFile
from prbench.readers.parse_cache import remembered_digest
from tests.readers.mps_files import NearTimes, trajectory_lines, write_lines, zipped

START = 5_000_000_000
TIMES = START + np.arange(3000, dtype=np.int64) * 1000
NEAR = NearGaze(START + np.arange(0, 3_000_000, 100_000, dtype=np.int64))
LONG_AGO = 1_600_000_000


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch) -> Path:
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("PRBENCH_PARSE_CACHE", "100")
    return tmp_path / "cache" / "parsed"


@pytest.fixture
def path(tmp_path) -> Path:
    return _settled(write_lines(tmp_path / "closed_loop_trajectory.csv", trajectory_lines(TIMES)))


def _settled(path: Path) -> Path:
    os.utime(path, (LONG_AGO, LONG_AGO))
    return path


@pytest.fixture
def searches(monkeypatch) -> list[object]:
    """Every file that was really read."""
    done, search = [], trajectory.search_rows

    def counted(source, *args, **options):
        done.append(source)
        return search(source, *args, **options)

    monkeypatch.setattr(trajectory, "search_rows", counted)
    return done


def same(one: mps.AriaTrajectory, other: mps.AriaTrajectory) -> bool:
    arrays = ("time_us", "position", "rotation", "quality", "up")
    facts = (one.graph_uids, one.left_out) == (other.graph_uids, other.left_out)
    return facts and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)


@pytest.mark.parametrize("archived", [False, True], ids=["plain", "zipped"])
def test_the_second_read_is_the_first_one_to_the_last_bit(path, searches, archived) -> None:
    source = zipped(path) if archived else path
    _settled(path.with_suffix(".zip") if archived else path)
    first, second = read_near(source, NEAR), read_near(source, NEAR)
    assert same(first, second)
    assert searches == [source]


@pytest.mark.parametrize("row", [1, 1500])
def test_a_changed_file_is_read_again(path, searches, row) -> None:
    first = read_near(path, NEAR)
    lines = trajectory_lines(TIMES)
    lines[row : row + 100] = [line.replace(",-1.5,", ",-2.5,") for line in lines[row : row + 100]]
    _settled(write_lines(path, lines))  # as long and, by its own word, as old as before
    second = read_near(path, NEAR)
    assert not same(first, second)
    assert len(searches) == 2
    os.utime(path, (LONG_AGO + 1, LONG_AGO + 1))
    read_near(path, NEAR)
    assert len(searches) == 3


def test_a_changed_member_of_an_archive_is_read_again(path, searches) -> None:
    source = zipped(path)
    _settled(source.archive)
    first = read_near(source, NEAR)
    lines = trajectory_lines(TIMES)
    lines[1500] = lines[1500].replace(",-1.5,", ",-2.5,")
    with zipfile.ZipFile(source.archive, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(source.member, "\n".join(lines) + "\n")
    _settled(source.archive)
    read_near(source, NEAR)
    assert len(searches) == 2
    assert same(first, read_near(zipped(path), NEAR))


def test_other_wishes_are_read_and_kept_anew(path, searches) -> None:
    for wish in (NEAR, NearGaze(NEAR.gaze_us + 1), NearGaze(NEAR.gaze_us + 1, rate=10.0), NearTimes(NEAR.gaze_us)):
        found = read_near(path, wish)
        assert same(found, read_near(path, wish))
    assert len(searches) == 4


def test_a_file_that_just_changed_is_not_kept(path, searches, cache) -> None:
    os.utime(path)
    read_near(path, NEAR)
    read_near(path, NEAR)
    assert len(searches) == 2
    assert not cache.exists()


def test_the_same_name_in_another_folder_is_another_file(path, searches, tmp_path) -> None:
    other = _settled(write_lines(tmp_path / "other" / path.name, trajectory_lines(TIMES + 7)))
    assert not same(read_near(path, NEAR), read_near(other, NEAR))
    assert len(searches) == 2


@pytest.mark.parametrize("damage", [b"", b"ARROW1\x00\x00 not much", None], ids=["empty", "cut", "half"])
def test_a_damaged_entry_is_made_again(path, searches, cache, damage) -> None:
    first = read_near(path, NEAR)
    (entry,) = cache.glob("*.arrow")
    entry.write_bytes(entry.read_bytes()[: entry.stat().st_size // 2] if damage is None else damage)
    assert same(first, read_near(path, NEAR))
    assert same(first, read_near(path, NEAR))
    assert len(searches) == 2


def test_the_cache_can_be_switched_off_and_cleared(path, searches, cache, monkeypatch) -> None:
    monkeypatch.setenv("PRBENCH_PARSE_CACHE", "off")
    read_near(path, NEAR)
    assert not cache.exists()
    monkeypatch.setenv("PRBENCH_PARSE_CACHE", "100")
    read_near(path, NEAR)
    assert len(list(cache.iterdir())) == 1
    shutil.rmtree(cache)
    read_near(path, NEAR)
    assert len(searches) == 3
    monkeypatch.setenv("PRBENCH_PARSE_CACHE", "plenty")
    with pytest.raises(UsageError, match="PRBENCH_PARSE_CACHE is 'plenty'"):
        read_near(path, NEAR)


def test_the_least_recently_used_entries_go_first(tmp_path, searches, cache, monkeypatch) -> None:
    paths = [_settled(write_lines(tmp_path / f"{n}.csv", trajectory_lines(TIMES))) for n in range(4)]
    read_near(paths[0], NEAR)
    (entry,) = cache.glob("*.arrow")
    size = entry.stat().st_size
    monkeypatch.setattr(parse_cache, "limit_bytes", lambda: int(2.5 * size))
    read_near(paths[1], NEAR)
    for number, kept in enumerate(sorted(cache.glob("*.arrow"), key=lambda kept: kept != entry)):
        os.utime(kept, (LONG_AGO + number, LONG_AGO + number))
    read_near(paths[0], NEAR)  # used: now the younger one
    read_near(paths[2], NEAR)
    assert entry.exists()
    assert len(list(cache.glob("*.arrow"))) == 2
    searches.clear()
    read_near(paths[0], NEAR)
    read_near(paths[1], NEAR)
    assert searches == [paths[1]]


def test_several_workers_write_the_same_entry(path, cache) -> None:
    expected, found = read_near(path, NEAR), []
    shutil.rmtree(cache)
    workers = [threading.Thread(target=lambda: found.append(read_near(path, NEAR))) for _ in range(6)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert len(found) == 6
    assert all(same(expected, one) for one in found)
    assert [entry.suffix for entry in cache.iterdir()] == [".arrow"]


def test_a_cache_that_cannot_be_written_does_not_stop_reading(path, tmp_path, monkeypatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "file"))
    assert len(read_near(path, NEAR).time_us) > 100
    large = tmp_path / "large.bin"
    large.write_bytes(bytes(2**21))
    _settled(large)
    assert remembered_digest(large) == file_digest(large)


def test_an_archive_that_lost_a_member_is_refused_as_without_the_cache(path) -> None:
    source = zipped(path)
    with pytest.raises(Exception, match=r"expected the file nothing\.csv in it"):
        read_near(ZippedFile(source.archive, "nothing.csv"), NEAR)


@pytest.fixture
def hashed(monkeypatch) -> list[Path]:
    done = []
    monkeypatch.setattr(parse_cache, "file_digest", lambda path: done.append(path) or file_digest(path))
    monkeypatch.setattr(parse_cache, "_SETTLED_NS", -1)  # no need to wait
    return done


def test_digests_are_of_contents_and_taken_once(tmp_path, hashed) -> None:
    large, small = tmp_path / "large.bin", tmp_path / "small.bin"
    large.write_bytes(bytes(2**21))
    small.write_bytes(b"x")
    for _ in range(3):
        assert remembered_digest(large) == file_digest(large)
        assert remembered_digest(small) == file_digest(small)
    assert hashed == [large, small, small, small]


def test_a_digest_follows_a_change_that_keeps_size_and_time(tmp_path, hashed) -> None:
    path = tmp_path / "large.bin"
    path.write_bytes(bytes(2**21))
    _settled(path)
    before = remembered_digest(path)
    content = bytearray(2**21)
    content[2**20] = 1
    path.write_bytes(content)
    _settled(path)
    assert remembered_digest(path) == file_digest(path) != before
    replaced = tmp_path / "new.bin"
    replaced.write_bytes(bytes(2**21))
    _settled(replaced).replace(path)
    assert remembered_digest(path) == before


def test_a_digest_of_a_file_that_just_changed_is_not_remembered(tmp_path, hashed, monkeypatch) -> None:
    monkeypatch.setattr(parse_cache, "_SETTLED_NS", 2_000_000_000)
    path = tmp_path / "large.bin"
    path.write_bytes(bytes(2**21))
    remembered_digest(path)
    remembered_digest(path)
    assert hashed == [path, path]


def test_digests_are_taken_again_when_the_cache_is_off(tmp_path, hashed, monkeypatch) -> None:
    path = tmp_path / "large.bin"
    path.write_bytes(bytes(2**21))
    remembered_digest(path)
    monkeypatch.setenv("PRBENCH_PARSE_CACHE", "off")
    remembered_digest(path)
    assert len(hashed) == 2


def test_an_entry_that_another_process_is_writing_is_never_deleted_as_the_oldest(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    folder = tmp_path / "parsed"
    folder.mkdir()
    for name in ("old.arrow", ".new-abcd1234.partial.arrow"):
        (folder / name).write_bytes(b"x" * 100)
    parse_cache._shrink(folder, 50)
    assert [path.name for path in folder.iterdir()] == [".new-abcd1234.partial.arrow"]
