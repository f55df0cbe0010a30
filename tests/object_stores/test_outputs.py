"""What is written at a URL: published whole, going on elsewhere, nothing good replaced by less."""

from __future__ import annotations

import contextlib

import fsspec
import pytest

from prbench.errors import InputFileError, StorageError
from prbench.object_stores.inputs import fetched
from prbench.object_stores.outputs import _OutputCopy, written_file, written_folder
from prbench.object_stores.store import FINISHED, OWN_PREFIX, UNFINISHED, ObjectStoreError, Store, StoreUrl
from tests.object_stores.conftest import contents, local_contents


def write(folder, **files):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)


def publish(url, **files):
    with written_folder(url) as (folder, _):
        write(folder, **files)


@contextlib.contextmanager
def interrupted(url):
    """A folder that is written at a URL by a block that is interrupted at its end."""
    with contextlib.suppress(KeyboardInterrupt), written_folder(url) as (folder, _):
        yield folder
        raise KeyboardInterrupt


def break_off(url, **files):
    """Write some files and be interrupted."""
    with interrupted(url) as folder:
        write(folder, **files)


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """Gives this process an empty cache, as on another machine."""
    machines = iter(range(100))

    def move():
        monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / f"machine-{next(machines)}"))
        monkeypatch.delenv("PRBENCH_LOCAL_COPIES", raising=False)

    return move


def test_a_folder_is_published_and_read(url):
    publish(url, a="1", b="2")
    assert sorted(contents(url)) == ["a", "b", FINISHED]
    assert local_contents(fetched(url)) == {"a": b"1", "b": b"2"}


def test_reading_an_unfinished_folder_says_what_to_do(url):
    break_off(url, a="1")
    with pytest.raises(InputFileError, match=r"an unfinished one. Run the command that writes it again"):
        fetched(url)


def test_another_machine_goes_on_with_finished_files_and_parts_beside_the_folder(url, elsewhere):
    with interrupted(url) as folder:
        write(folder, a="1")
        write(folder.parent / f".{folder.name}.work" / "part", receipt="r")
        write(folder, **{".b-12345678.partial": "half"})
    elsewhere()
    with written_folder(url) as (folder, _):
        assert local_contents(folder) == {"a": b"1"}
        assert local_contents(folder.parent / f".{folder.name}.work") == {"part/receipt": b"r"}
        write(folder, b="2")
    assert sorted(contents(url)) == ["a", "b", FINISHED]


def test_what_was_uploaded_before_another_file_vanished_does_not_stay(url, monkeypatch):
    copy = _OutputCopy(Store(StoreUrl.parse(url)), print)
    copy.begin()
    write(copy.folder, a="passing", b="vanishes")
    upload = Store.upload

    def vanishing(store, path, name):
        upload(store, path, name)
        (copy.folder / "b").unlink(missing_ok=True)

    with monkeypatch.context() as patched:
        patched.setattr(Store, "upload", vanishing)
        copy.keep()
    assert "a" in contents(url)
    (copy.folder / "a").unlink()
    write(copy.folder, c="3")
    copy.publish()
    assert sorted(contents(url)) == ["c", FINISHED]


def test_the_same_machine_goes_on_with_what_was_not_uploaded_yet(url):
    break_off(url, a="1")
    copy = _OutputCopy(Store(StoreUrl.parse(url)), print)
    write(copy.folder, b="2")  # by a command that was killed before it could upload it
    with written_folder(url) as (folder, _):
        assert local_contents(folder) == {"a": b"1", "b": b"2"}


def test_a_folder_that_was_emptied_begins_anew(url):
    break_off(url, a="1")
    system, top = fsspec.url_to_fs(url)
    system.rm(top, recursive=True)
    with written_folder(url) as (folder, _):
        assert not folder.exists()
        write(folder, b="2")
    assert sorted(contents(url)) == ["b", FINISHED]


def test_readers_find_the_earlier_folder_until_the_new_one_is_whole(url, elsewhere):
    publish(url, a="old", same="x")
    with interrupted(url) as folder:
        (folder / "a").write_text("new")
    elsewhere()
    assert local_contents(fetched(url)) == {"a": b"old", "same": b"x"}
    with written_folder(url) as (folder, _):
        assert local_contents(folder) == {"a": b"new", "same": b"x"}
    assert local_contents(fetched(url)) == {"a": b"new", "same": b"x"}
    objects = sorted(contents(url))
    assert objects[1:] == [FINISHED, "same"]
    assert objects[0].startswith(OWN_PREFIX)  # the earlier file was never overwritten
    assert contents(url)[objects[0]] == b"new"


def test_the_manifest_does_not_depend_on_what_was_uploaded_when(url, elsewhere):
    break_off(url, a="draft")
    elsewhere()
    publish(url, a="final", b="2")
    other = f"{url}-at-once"
    publish(other, a="final", b="2")
    assert contents(url) == contents(other)


def test_an_upload_that_fails_replaces_nothing_and_the_same_command_uploads(url, monkeypatch):
    publish(url, a="old", b="old")
    uploads = []

    def failing(self, path, name):
        if uploads:
            raise ObjectStoreError("the store was stopped.")
        uploads.append(name)
        upload(self, path, name)

    upload = Store.upload
    with (  # noqa: PT012 - what raises is the end of the block
        pytest.raises(ObjectStoreError, match=r"stopped.* is kept in .*, and nothing at the URL was replaced"),
        written_folder(url) as (folder, _),
    ):
        monkeypatch.setattr(Store, "upload", failing)
        write(folder, a="new", b="new")
    assert local_contents(fetched(url)) == {"a": b"old", "b": b"old"}
    monkeypatch.setattr(Store, "upload", upload)
    with written_folder(url) as (folder, _):
        assert local_contents(folder) == {"a": b"new", "b": b"new"}
    assert local_contents(fetched(url)) == {"a": b"new", "b": b"new"}
    assert len(contents(url)) == 3


def test_a_store_that_fails_while_a_command_works_is_told_once(url, monkeypatch):
    said = []
    with written_folder(url, tell=said.append) as (folder, _):
        copy = _OutputCopy(Store(StoreUrl.parse(url)), said.append)
        write(folder, a="1")
        with monkeypatch.context() as broken:
            broken.setattr(Store, "write", _unreachable)
            copy.keep()
            copy.keep()
        assert len(said) == 1
        assert "Finished parts are kept in the local copy" in said[0]
    assert sorted(contents(url)) == ["a", FINISHED]


def _unreachable(self, name, content):
    raise ObjectStoreError("unreachable.")


def test_two_that_write_at_once_are_told_and_lose_nothing(url, elsewhere):
    with (  # noqa: PT012 - likewise
        pytest.raises(StorageError, match="another command writes there too, or has written there"),
        written_folder(url) as (folder, _),
    ):
        write(folder, a="mine")
        elsewhere()
        publish(url, a="theirs")
    assert local_contents(folder) == {"a": b"mine"}
    assert local_contents(fetched(url)) == {"a": b"theirs"}


def test_a_folder_of_something_else_is_not_written_to(url):
    system, top = fsspec.url_to_fs(url)
    system.pipe_file(f"{top}/precious.txt", b"x")
    with pytest.raises(StorageError, match=r"is not empty and holds no prbench-manifest.json"):
        publish(url, a="1")
    assert sorted(contents(url)) == ["precious.txt"]


def test_what_is_left_of_a_kill_between_manifest_and_clearing_away_goes_next_time(url):
    break_off(url, a="1", b="2")
    left = contents(url)[UNFINISHED]
    publish(url, a="1", b="3")
    system, top = fsspec.url_to_fs(url)
    system.pipe_file(f"{top}/{UNFINISHED}", left)
    publish(url, a="1", b="4")
    assert local_contents(fetched(url)) == {"a": b"1", "b": b"4"}
    assert UNFINISHED not in contents(url)


def test_a_file_is_uploaded_with_what_stands_beside_it_and_seen_before_it_is_replaced(url):
    for text in ("one", "two"):
        with written_file(f"{url}/board.md") as path:
            assert path.exists() == (text == "two")
            write(path.parent, **{"board.md": text, "board.csv": text})
    assert contents(url) == {"board.md": b"two", "board.csv": b"two"}
