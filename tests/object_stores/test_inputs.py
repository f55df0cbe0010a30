"""What is read at a URL: whole, checked, and only what is asked for."""

from __future__ import annotations

import errno
import json

import fsspec
import pytest

from prbench.errors import InputFileError, StorageError
from prbench.object_stores.inputs import fetched, fetched_native
from prbench.object_stores.store import FINISHED, ObjectStoreError, Store, StoreUrl
from tests.object_stores.conftest import contents, local_contents
from tests.object_stores.test_outputs import publish


@pytest.fixture
def folder(url):
    """A published folder of two files."""
    publish(url, a="abc", b="12")
    return url


def put(url, **objects):
    system, top = fsspec.url_to_fs(url)
    for name, content in objects.items():
        system.pipe_file(f"{top}/{name}", content)


def test_nothing_is_fetched_twice(folder):
    said = []
    first = fetched(folder, tell=said.append)
    assert fetched(folder, tell=said.append) == first
    assert said == [f"{folder}: fetching 2 files, 0.0 MB."]


def test_another_state_of_a_folder_is_another_copy(folder):
    first = fetched(folder)
    publish(folder, a="changed")
    assert local_contents(fetched(folder)) == {"a": b"changed", "b": b"12"}
    assert local_contents(first) == {"a": b"abc", "b": b"12"}  # whoever reads it still can


@pytest.mark.parametrize(("times", "is_read"), [(4, True), (5, False)])
def test_an_object_that_a_writer_replaces_meanwhile_is_read_again(folder, monkeypatch, times, is_read):
    system, _ = fsspec.url_to_fs(folder)
    opened = type(system).open
    replaced = iter(range(times))

    def replacing(self, *given, **more):
        if next(replaced, None) is not None:
            raise OSError(errno.EBUSY, "no longer exists")
        return opened(self, *given, **more)

    monkeypatch.setattr(type(system), "open", replacing)
    store = Store(StoreUrl.parse(folder))
    if is_read:
        assert store.read("a", largest=10) == b"abc"
    else:
        with pytest.raises(ObjectStoreError, match="cannot read a"):
            store.read("a", largest=10)


@pytest.mark.parametrize(
    ("content", "expected"), [(b"ab", "3 bytes, found 2"), (b"abcd", "3 bytes, found 4"), (b"abd", "the SHA-256")]
)
def test_a_changed_object_is_refused_and_nothing_half_is_left(folder, content, expected, tmp_path):
    put(folder, a=content)
    with pytest.raises(InputFileError, match=expected):
        fetched(folder)
    assert not [path for path in tmp_path.rglob("*") if path.name in ("a",) and path.parent.parent.name != "out"]


def test_an_object_that_grows_while_it_is_read_is_not_read_on(folder, monkeypatch):
    class Growing:
        size = 3

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def read(self, count):
            return b"x" * count

    system = type(fsspec.filesystem("memory"))
    opened = system.open

    def open_or_grow(self, path, *rest, **more):
        return Growing() if path.endswith("/a") else opened(self, path, *rest, **more)

    monkeypatch.setattr(system, "open", open_or_grow)
    with pytest.raises(InputFileError, match="expected 3 bytes, found more"):
        fetched(folder)


def test_a_connection_that_breaks_in_the_middle_leaves_nothing_half(folder, monkeypatch):
    class Breaking:
        size = 3

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def read(self, count):
            raise ConnectionResetError(104, "Connection reset by peer", "http://host/a?X-Amz-Signature=hunter2")

    system = type(fsspec.filesystem("memory"))
    opened = system.open
    with monkeypatch.context() as patched:
        patched.setattr(
            system,
            "open",
            lambda self, path, *rest, **more: Breaking() if path.endswith("/a") else opened(self, path, *rest, **more),
        )
        with pytest.raises(ObjectStoreError, match=r"the connection was lost .*run the same command again") as lost:
            fetched(folder)
    assert "hunter2" not in str(lost.value)
    assert folder in str(lost.value)
    assert local_contents(fetched(folder)) == {"a": b"abc", "b": b"12"}


def test_denied_access_names_credentials(folder, monkeypatch):
    def denied(*_args, **_more):
        raise PermissionError("Access Denied")

    monkeypatch.setattr(type(fsspec.filesystem("memory")), "open", denied)
    with pytest.raises(ObjectStoreError, match=r"access is denied .*Check the credentials"):
        fetched(folder)


def test_a_manifest_whose_names_lead_out_is_refused_before_anything_is_fetched(folder, tmp_path):
    manifest = json.loads(contents(folder)[FINISHED])
    manifest["files"]["../../evil"] = manifest["files"]["a"]
    put(folder, **{FINISHED: json.dumps(manifest).encode()})
    with pytest.raises(InputFileError, match="may lead out of it"):
        fetched(folder)
    assert not list(tmp_path.rglob("evil"))


def test_a_folder_replaced_while_it_is_fetched_is_fetched_in_its_new_state(folder, monkeypatch):
    download = Store.download
    replaced = []

    def replacing(self, name, target, **more):
        if not replaced:
            replaced.append(name)
            publish(folder, a="new", b="new")
        download(self, name, target, **more)

    monkeypatch.setattr(Store, "download", replacing)
    assert local_contents(fetched(folder)) == {"a": b"new", "b": b"new"}


def test_a_single_file_is_fetched_anew_when_it_changes(url):
    for content in (b"one", b"two"):
        put(url, **{"motions.npz": content})
        path = fetched(f"{url}/motions.npz")
        assert (path.name, path.read_bytes()) == ("motions.npz", content)


def test_a_full_disk_is_told_before_the_first_byte(folder, monkeypatch):
    class Disk:
        free = 4

    monkeypatch.setattr("prbench.object_stores.inputs.shutil.disk_usage", lambda _: Disk)
    with pytest.raises(StorageError, match=r"are free. Free some space, or name another folder by PRBENCH_CACHE"):
        fetched(folder)


def test_native_files_are_those_that_the_reader_asks_for(url):
    put(
        url,
        **{
            "synthetic.json": b"{}",
            "rec/metadata.json": b"{}",
            "rec/video.vrs": b"x" * 1000,
            "rec/mps/eye_gaze/general_eye_gaze.csv": b"1",
            "rec/mps/slam/semidense_points.csv.gz": b"1",
            "notes.txt": b"",
        },
    )
    root = fetched_native(url, "adt")
    wanted = {"synthetic.json", "rec/metadata.json", "rec/mps/eye_gaze/general_eye_gaze.csv"}
    assert set(local_contents(root)) == wanted
    system, top = fsspec.url_to_fs(url)
    system.rm_file(f"{top}/rec/metadata.json")
    assert set(local_contents(fetched_native(url, "adt"))) == wanted - {"rec/metadata.json"}


def test_archives_and_what_they_were_unpacked_to_are_both_found(url):
    place = "HD-EPIC/SLAM-and-Gaze/P01/SLAM/multi"
    put(
        url,
        **{f"{place}/0.zip": b"z", f"{place}/1/slam/closed_loop_trajectory.csv": b"1", f"{place}/1/slam/x.vrs": b""},
    )
    root = fetched_native(url, "hd-epic")
    assert set(local_contents(root)) == {f"{place}/0.zip", f"{place}/1/slam/closed_loop_trajectory.csv"}
    inner = fetched_native(f"{url}/HD-EPIC", "hd-epic")  # one level farther down
    assert set(local_contents(inner)) == {name.removeprefix("HD-EPIC/") for name in local_contents(root)}


def test_a_place_without_native_files_says_what_was_looked_for(url):
    put(url, **{"notes.txt": b""})
    with pytest.raises(InputFileError, match="expected files of adt, found 1 other files"):
        fetched_native(url, "adt")
