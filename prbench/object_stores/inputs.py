"""Folders and files at URLs that are read: copied into the cache folder, each file whole and checked, or not at all."""

from __future__ import annotations

import fnmatch
import os
import re
import shutil
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path, PurePosixPath

import msgspec

from prbench.datasets import readable_datasets
from prbench.errors import InputFileError, PrbenchError, StorageError
from prbench.files.storage import in_turn, remove_folder, text_digest, write_bytes
from prbench.object_stores import store as stores
from prbench.protocol.manifests import load_manifest
from prbench.shown import clean

Tell = Callable[[str], None]
# Files that are fetched at the same time; most of a small file's time is waiting.
_AT_ONCE = 8
# Days after which an older state of a folder is deleted from the cache.
_UNUSED_DAYS = 7
# Marks recordings of synthetic people; no dataset's list of files names it.
_MARK = "synthetic.json"
# Endings of files that are fetched from folders which stand in place of an archive.
_UNPACKED = (".csv", ".json", ".jsonl")


def fetched(text: str, *, tell: Tell = lambda _: None) -> Path:
    """Copy a finished folder or a single file from a URL into the cache, as far as it is not there yet.

    Args:
        text: The URL.
        tell: Called with a line before something is fetched.

    Returns:
        The local copy. A folder's copy never changes: another state of the folder gets another copy.

    Raises:
        UsageError: for a URL that holds something secret, or of an unknown protocol.
        MissingExtraError: if fsspec or the package of the protocol is missing.
        InputFileError: if there is nothing, something unfinished, or something without a manifest; or a file has
            another size or digest than its manifest says.
        StorageError: if the store cannot be reached, or the disk is full.
    """
    if (known := stores.opened_elsewhere(text)) is not None:
        return known
    store = stores.Store(stores.StoreUrl.parse(text))
    for last_try in (False, True):
        manifest = read_manifest(store)
        if manifest is None:
            return _fetched_file(store, tell)
        folder = store.url.cache / manifest.digest[:16] / store.url.name
        try:
            with in_turn(folder, tell):
                fetch_files(store, manifest, lambda name, folder=folder: folder / name, tell)
                folder.mkdir(parents=True, exist_ok=True)
                os.utime(folder.parent)  # used now
                # Delete copies of other states of a folder that nobody has used for some days.
                for other in folder.parent.parent.iterdir():
                    is_state = len(other.name) == 16 and other.is_dir() and other != folder.parent
                    if is_state and time.time() - other.stat().st_mtime > _UNUSED_DAYS * 86_400:
                        remove_folder(other)
            return folder
        except InputFileError:
            # Whoever replaces a folder deletes the older files after the new manifest stands.
            if last_try or read_manifest(store) == manifest:
                raise
    raise AssertionError


def read_manifest(store: stores.Store, name: str = stores.FINISHED) -> stores.FolderManifest | None:
    """Read the manifest of a folder, by default that of a finished one; None if there is none."""
    content = store.read(name, largest=stores.LARGEST_MANIFEST)
    return None if content is None else stores.decode_manifest(content, f"{store.url}/{name}")


def fetch_files(
    store: stores.Store, manifest: stores.FolderManifest, target: Callable[[str], Path], tell: Tell
) -> None:
    """Copy those files of a manifest that are not there in their size.

    Args:
        store: Store that they lie in.
        manifest: Names, sizes and digests.
        target: Gives the local path of each name.
        tell: Called with a line before something is fetched.
    """
    missing = {name: file for name, file in manifest.files.items() if not _has_size(target(name), file.size)}
    downloads = [
        partial(store.download, manifest.object_of(name), target(name), size=file.size, sha256=file.sha256)
        for name, file in missing.items()
    ]
    _download_all(store, downloads, tell)


def _fetched_file(store: stores.Store, tell: Tell) -> Path:
    url = store.url
    found = store.describe()
    if found is None:
        # It names no file and holds no manifest.
        remedy = "Correct the URL."
        if store.read(stores.UNFINISHED, largest=stores.LARGEST_MANIFEST) is not None:
            what = "an unfinished one"
            remedy = "Run the command that writes it again with the same --out: it goes on, here or on another machine."
        elif store.is_empty():
            what = "nothing"
        else:
            what = f"other files and no {stores.FINISHED}"
            written = "`python -m prbench.object_stores.store DIR` writes the manifest to copy with it, last."
            copied = "Of a folder that was copied by another program"
            remedy = f"Only what prbench has finished is read there. {copied}: {written}"
        expected = "a finished folder of prbench, or a file"
        raise InputFileError(str(url), "", expected=expected, found=what, remedy=remedy)
    path = url.cache / "file" / text_digest(found.version, str(found.size))[:16] / url.name
    with in_turn(path, tell):
        # An object without a version may have changed and kept its size.
        if not found.version or not _has_size(path, found.size):
            _download_all(store, [partial(store.download, "", path, size=found.size)], tell)
    return path


def fetched_native(text: str, dataset: str | None, *, tell: Tell = lambda _: None) -> Path:
    """Copy a dataset's native files from a URL into the cache: those that its readers ask for, no videos.

    All recordings are fetched before the first is read, because readers search whole folders. Objects that have
    changed are fetched again, and what is not there any more is deleted from the copy.

    Args:
        text: The URL of the dataset's folder.
        dataset: Name of the dataset; None for any.
        tell: Called with a line before something is fetched.

    Raises:
        UsageError, MissingExtraError, StorageError: as :func:`fetched` raises them.
        InputFileError: if nothing lies there that a reader asks for.
    """
    if (known := stores.opened_elsewhere(text)) is not None:
        return known
    store = stores.Store(stores.StoreUrl.parse(text))
    # The files that readers ask for, each as patterns for the last parts of a path.
    names = readable_datasets() if dataset is None else (dataset,)
    found: set[tuple[str, ...]] = {(_MARK,)}
    for name in names:
        try:
            manifest = load_manifest(name)
        except PrbenchError:
            if dataset is not None:
                raise
            continue  # a package's reader that cannot be used; the search for recordings says so
        for file in (*manifest.required_files, *manifest.optional_files):
            parts = [part.replace("P0X", "P*") for part in file.split("/") if part != ".."]
            found.add(tuple(re.sub("<[^>]*>", "*", part) for part in parts))  # such as <video>_log.json
    patterns = sorted(found)
    above = tuple(part for part in store.url.text.partition("://")[2].split("/") if part)
    listed = store.listing()
    if dataset is None and (not listed or any(each.name == "dataset.json" for each in listed)):
        # A built table is fetched by its digests. Where nothing lies, this also tells a bucket that is missing.
        return fetched(text, tell=tell)
    wanted = [each for each in listed if _is_wanted((*above, *each.name.split("/")), patterns)]
    if not wanted:
        store.is_empty()  # a bucket that does not exist is told as such
        expected = f"files of {dataset or 'a dataset'}"
        held = f"{len(listed)} other files" if listed else "nothing"
        remedy = "`prbench datasets` says which files each dataset consists of."
        raise InputFileError(str(store.url), "", expected=expected, found=held, remedy=remedy)
    for each in wanted:
        path = PurePosixPath(each.name)
        if path.is_absolute() or ".." in path.parts or path.as_posix() != each.name or clean(each.name) != each.name:
            outside = {"expected": "a path inside this folder", "found": "a path that may lead out of it"}
            raise InputFileError(str(store.url), each.name, **outside)
    root = store.url.cache / f"native-{dataset or 'any'}" / store.url.name
    with in_turn(root, tell):
        _mirror(store, wanted, root, tell)
    return root


def _mirror(store: stores.Store, wanted: Sequence[stores.StoredObject], root: Path, tell: Tell) -> None:
    """Make a folder equal to some objects; versions are kept beside it, as no digest of them is known."""
    kept = root.parent / "versions.json"
    try:
        before = msgspec.json.decode(kept.read_bytes(), type=dict[str, str])
    except (OSError, msgspec.DecodeError):
        before = {}
    versions = {each.name: f"{each.size} {each.version}" for each in wanted}
    changed = [
        each
        for each in wanted
        if not each.version
        or before.get(each.name) != versions[each.name]
        or not _has_size(root / each.name, each.size)
    ]
    unchanged = {name: version for name, version in versions.items() if name not in {each.name for each in changed}}
    write_bytes(kept, msgspec.json.encode(unchanged))  # a killed download fetches the changed ones again
    for path in [path for path in root.rglob("*") if path.is_file()]:
        if path.relative_to(root).as_posix() not in versions:
            path.unlink()
    downloads = [partial(store.download, each.name, root / each.name, size=each.size) for each in changed]
    _download_all(store, downloads, tell)
    write_bytes(kept, msgspec.json.encode(versions))


def _is_wanted(path: Sequence[str], patterns: Iterable[Sequence[str]]) -> bool:
    for pattern in patterns:
        if _ends_like(path, pattern):
            return True
        # Text files below the folder that a user has unpacked an archive into.
        if pattern[-1].endswith(".zip") and path[-1].endswith(_UNPACKED):
            folder = (*pattern[:-1], pattern[-1].removesuffix(".zip"))
            if any(_ends_like(path[:end], folder) for end in range(len(folder), len(path))):
                return True
    return False


def _ends_like(path: Sequence[str], pattern: Sequence[str]) -> bool:
    if len(path) < len(pattern):
        return False
    return all(fnmatch.fnmatchcase(part, each) for part, each in zip(path[-len(pattern) :], pattern, strict=True))


def _has_size(path: Path, size: int) -> bool:
    try:
        return path.stat().st_size == size
    except OSError:
        return False


def _download_all(store: stores.Store, downloads: Sequence[partial[None]], tell: Tell) -> None:
    """Fetch some files, several at once; the first that fails ends it.

    Raises:
        StorageError: if the disk has no room for them.
    """
    if not downloads:
        return
    total = sum(download.keywords["size"] for download in downloads)
    store.url.cache.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(store.url.cache).free
    if total > free:
        problem = f"{total / 1e6:,.0f} MB of {store.url} are to be copied here, and {free / 1e6:,.0f} MB are free"
        remedy = "Free some space, or name another folder by PRBENCH_CACHE."
        raise StorageError(f"{store.url.cache}: {problem}. {remedy}")
    tell(f"{store.url}: fetching {len(downloads)} files, {total / 1e6:,.1f} MB.")
    with ThreadPoolExecutor(_AT_ONCE) as pool:
        under_way = [pool.submit(download) for download in downloads]
        try:
            for each in under_way:
                each.result()
        except BaseException:  # start no further download once one has failed, or somebody has pressed Ctrl-C
            pool.shutdown(wait=False, cancel_futures=True)
            raise
