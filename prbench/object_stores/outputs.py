"""Folders and files at URLs that are written: worked on as a local copy, uploaded meanwhile, the manifest last."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import threading
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from prbench.errors import InputFileError, StorageError, UsageError
from prbench.files.storage import file_digest, remove_folder, sole_writer, write_bytes
from prbench.object_stores import store as stores
from prbench.object_stores.inputs import Tell, fetch_files, read_manifest

# Environment variable: seconds between two uploads of finished parts while a command works.
SECONDS_VARIABLE = "PRBENCH_UPLOAD_SECONDS"
_SECONDS = 15.0
# Names of files and folders that are being written, or held; never uploaded.
_PASSING = re.compile(r"\..*(\.partial|\.replaced|\.lock)")


@dataclass
class Outcome:
    """How a block that writes a folder has ended; it sets this itself.

    Attributes:
        finished: The folder is published. Else it stays unfinished, as after an error, and the same command goes on.
    """

    finished: bool = True


@contextlib.contextmanager
def written_folder(text: str, *, tell: Tell = lambda _: None) -> Iterator[tuple[Path, Outcome]]:
    """Yield a local folder that becomes the one at a URL when the block ends well.

    It begins as what lies there: the finished folder, or what an interrupted command has uploaded. While the block
    works, and when it fails or is interrupted, finished files are uploaded beside what stood there. At the end
    everything is uploaded, then the manifest, and then what it replaces is deleted.

    Args:
        text: The URL.
        tell: Called with lines on what is fetched and uploaded.

    Raises:
        UsageError: for a URL that holds something secret, or of an unknown protocol.
        MissingExtraError: if fsspec or the package of the protocol is missing.
        StorageError: if the store cannot be reached, something else lies there, or another command writes there.
    """
    if (known := stores.opened_elsewhere(text)) is not None:
        yield known, Outcome()
        return
    copy = _OutputCopy(stores.Store(stores.StoreUrl.parse(text)), tell)
    outcome = Outcome()
    copy.folder.parent.mkdir(parents=True, exist_ok=True)
    with sole_writer(copy.folder.parent):
        copy.begin()
        try:
            with stores.opened(text, copy.folder), copy.uploading():
                yield copy.folder, outcome
        except BaseException:
            copy.keep()
            raise
        if outcome.finished:
            copy.publish()
        else:
            copy.keep()


@contextlib.contextmanager
def written_file(text: str, *, tell: Tell = lambda _: None) -> Iterator[Path]:
    """Yield a local file that is uploaded when the block ends well, with what the block has written beside it.

    A file that lies there already is fetched first, so that whoever never overwrites one sees it.

    Raises:
        StorageError: see :func:`written_folder`, whose other errors these are, too.
    """
    url = stores.StoreUrl.parse(text)
    store = stores.Store(url)
    beside = stores.Store(url.parent)
    with sole_writer(url.cache / "new"):
        beside.is_empty()  # a bucket that does not exist is told before the work
        folder = url.cache / "new"
        remove_folder(folder)
        folder.mkdir(parents=True)
        path = folder / url.name
        if (found := store.describe()) is not None:
            store.download("", path, size=found.size)
        before = _local_files(folder)
        yield path
        for name, status in _local_files(folder).items():
            if before.get(name) != status:
                try:
                    beside.upload(folder / name, name)
                except stores.ObjectStoreError as error:
                    raise stores.ObjectStoreError(f"{error} Until then the file lies in {folder / name}.") from error
                tell(f"{url.parent}/{name}: uploaded.")


class _State(msgspec.Struct, frozen=True, kw_only=True):
    """What a local copy was made from, so that the next command knows if it is still the newest.

    Attributes:
        uploaded: Something of it was uploaded before it was finished.
    """

    begun_from: str
    writer: str
    uploaded: bool


# Size in bytes, and time of the last change in nanoseconds.
_Status = tuple[int, int]


@dataclass
class _OutputCopy:
    """The local copy of a folder that is written at a URL.

    ``folder`` is the folder itself, ``work`` the one of intermediate parts that a build puts beside it.

    Attributes:
        before: The finished folder that stood there at the beginning.
        known: What this command, or the one that it goes on from, has uploaded of unfinished work.
        left_over: Objects that the last manifest may not name, so that they are deleted after it is written.
        failed: The last upload failed, and that was told.
    """

    store: stores.Store
    tell: Tell
    writer: str = field(default_factory=lambda: secrets.token_hex(8))
    before: stores.FolderManifest | None = None
    known: stores.FolderManifest | None = None
    left_over: set[str] = field(default_factory=set)
    digests: dict[str, tuple[_Status, str]] = field(default_factory=dict)
    failed: bool = False

    @property
    def folder(self) -> Path:
        url = self.store.url
        return url.cache / "out" / url.name

    @property
    def work(self) -> Path:
        return self.folder.parent / f".{self.folder.name}.work"

    @property
    def _begun_from(self) -> str:
        return "" if self.before is None else self.before.digest

    def begin(self) -> None:
        """Make the local copy equal to what lies there, unless it is newer."""
        store = self.store
        self.before = read_manifest(store)
        self.known = read_manifest(store, stores.UNFINISHED)
        if self.before is None and self.known is None and not store.is_empty():
            why = "so it is nothing that may be replaced. Choose an empty or new folder for --out."
            raise StorageError(f"{store.url}: is not empty and holds no {stores.FINISHED}, {why}")
        if self.known is not None and self.known.begun_from != self._begun_from:
            # A command was killed after the manifest and before it had cleared away, or another one has finished since.
            self.left_over = {stores.UNFINISHED, *self.known.objects}
            self.known = None
        if not self._local_is_newest():
            remove_folder(self.work)
            remove_folder(self.folder)
            if (manifest := self.known or self.before) is not None:
                fetch_files(store, manifest, self._local, self.tell)
            if self.known is not None:
                self.tell(f"{store.url}: going on with what an interrupted command has uploaded.")
        self._remember()

    def _local_is_newest(self) -> bool:
        try:
            state = msgspec.json.decode((self.store.url.cache / "out.json").read_bytes(), type=_State)
        except (OSError, msgspec.DecodeError):
            return False
        if state.begun_from != self._begun_from:
            return False
        if self.known is None:
            return not state.uploaded  # else somebody has emptied the folder
        return self.known.writer == state.writer

    def _remember(self) -> None:
        writer = (self.known.writer if self.known else None) or self.writer
        state = _State(begun_from=self._begun_from, writer=writer, uploaded=self.known is not None)
        write_bytes(self.store.url.cache / "out.json", msgspec.json.encode(state))

    def _local(self, name: str) -> Path:
        """Path of a file of the manifest: in the folder, or in that of intermediate parts."""
        if name.startswith(stores.WORK_PREFIX):
            return self.work / name.removeprefix(stores.WORK_PREFIX)
        return self.folder / name

    @contextlib.contextmanager
    def uploading(self) -> Iterator[None]:
        """Upload finished files every few seconds while the block works."""
        stop = threading.Event()
        given = os.environ.get(SECONDS_VARIABLE, "")
        try:
            pause = float(given or _SECONDS)
        except ValueError:
            pause = 0.0
        if not 0 < pause < 86_400:
            raise UsageError(f"{SECONDS_VARIABLE}: expected seconds above 0, found '{given}'.")

        def work() -> None:
            while not stop.wait(pause):
                self.keep()

        thread = threading.Thread(target=work, name="upload", daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def keep(self) -> None:
        """Upload what is finished of unfinished work; if that fails, say so and what is kept here."""
        try:
            self._upload_unfinished()
            self.failed = False
        except FileNotFoundError:
            return  # a file went while it was looked at; the next time will find all in one state
        except (StorageError, InputFileError) as error:
            if not self.failed:  # told once, not every few seconds
                self.tell(f"note: {error} Finished parts are kept in the local copy {self.folder}.")
            self.failed = True

    def _upload_unfinished(self) -> None:
        found = self._scanned(with_work=True)
        there = self.known or self.before
        if not found or (there is not None and _contents(found) == _contents(there.files)):
            return
        taken = dict(self.known.objects if self.known else {})
        taken |= self.before.objects if self.before else {}
        files = _placed(found, taken)
        self._require_no_other()
        # The folder has to be known for an unfinished one before the first object lies in it.
        self._announce(self.known.files if self.known else {})
        # Should a file vanish before all are uploaded, no manifest will name these: the last one removes them.
        self.left_over |= {file.object or name for name, file in files.items()}
        self._upload(files, taken)
        self._announce(files)

    def _announce(self, files: Mapping[str, stores.StoredFile]) -> None:
        """Write the manifest of unfinished work; what it no longer names goes with the next manifest."""
        manifest = stores.FolderManifest.of(files)
        self.left_over |= (self.known.objects.keys() if self.known else set()) - manifest.objects.keys()
        self.known = msgspec.structs.replace(manifest, writer=self.writer, begun_from=self._begun_from)
        self.store.write(stores.UNFINISHED, self.known.encoded())
        self._remember()

    def _upload(self, files: Mapping[str, stores.StoredFile], there: Mapping[str, str]) -> None:
        """Upload the files whose objects are not there yet."""
        for name, file in files.items():
            target = file.object or name
            if there.get(target) == file.sha256:
                continue
            self.store.upload(self._local(name), target)
            if self._described(name, self._local(name)) != (file.size, file.sha256):
                raise FileNotFoundError(f"{name} was written meanwhile")

    def _require_no_other(self) -> None:
        """Refuse to go on where another command has begun to write since.

        Raises:
            StorageError: if one has.
        """
        now = read_manifest(self.store)
        unfinished = read_manifest(self.store, stores.UNFINISHED)
        mine = self.known.writer if self.known else None
        begun_since = (
            unfinished is not None
            and unfinished.writer not in (mine, self.writer)
            and unfinished.begun_from == self._begun_from  # else it is a leftover
        )
        if (now.digest if now else "") != self._begun_from or begun_since:
            problem = "another command writes there too, or has written there since this one began."
            kept = f"Nothing of it was replaced; what this command has made lies in {self.folder}."
            remedy = "Let one of the two end, then run the other again."
            raise StorageError(f"{self.store.url}: {problem} {kept} {remedy}")

    def publish(self) -> None:
        """Upload everything, then the manifest, then delete what it replaces.

        Raises:
            StorageError: if the store cannot be written; says that the local copy is kept.
        """
        try:
            self._publish()
        except stores.ObjectStoreError as error:
            kept = f"The finished result is kept in {self.folder}, and nothing at the URL was replaced"
            raise stores.ObjectStoreError(f"{error} {kept}; the same command uploads it.") from error
        except FileNotFoundError as error:
            problem = f"a file was changed or deleted while it was uploaded to {self.store.url} ({error})"
            remedy = "run the same command again when nothing else works in this folder."
            raise StorageError(f"{self.folder}: {problem}. Nothing at the URL was replaced; {remedy}") from error

    def _publish(self) -> None:
        files = self._scanned(with_work=False)
        if not files:
            return
        before = self.before.objects if self.before else {}
        known = self.known.objects if self.known else {}
        placed = _placed(files, before)
        manifest = stores.FolderManifest.of(placed)
        if self.before is not None and _contents(manifest.files) == _contents(self.before.files):
            manifest = self.before
        else:
            self._require_no_other()
            there = known | before
            overwritten = {file.object or name for name, file in placed.items()}
            overwritten -= {name for name in overwritten if there.get(name) == manifest.objects[name]}
            # A file that was uploaded in an earlier state is overwritten under its own name: the manifest shall not
            # depend on when files were uploaded. Until it stands, that file counts as not uploaded.
            kept = self.known.files if self.known else {}
            if overwritten:
                self._announce({name: file for name, file in kept.items() if (file.object or name) not in overwritten})
            self._upload(placed, there)
            self.store.write(stores.FINISHED, manifest.encoded())
            size = sum(file.size for file in files.values())
            self.tell(f"{self.store.url}: {len(files)} files, {size / 1e6:,.1f} MB; the local copy is {self.folder}.")
        if self.known is not None or self.left_over:
            # Last of all: while it stands, the next command clears away what this one does not come to.
            own = stores.Store(stores.StoreUrl(f"{self.store.url.text}/{stores.OWN_PREFIX.rstrip('/')}"))
            self.left_over |= {f"{stores.OWN_PREFIX}{each.name}" for each in own.listing()}
        old = set(before) | set(known) | self.left_over
        self.store.remove(sorted(old - manifest.objects.keys() - {stores.UNFINISHED}))
        if self.known is not None or self.left_over:
            self.store.remove([stores.UNFINISHED])
        self.before, self.known, self.left_over = manifest, None, set()
        self._remember()

    def _scanned(self, *, with_work: bool) -> dict[str, stores.StoredFile]:
        """Describe every finished file.

        Raises:
            FileNotFoundError: if one vanishes meanwhile.
            StorageError: for a name that no manifest may hold.
        """
        places = {"": self.folder} | ({stores.WORK_PREFIX: self.work} if with_work else {})
        found = {}
        for prefix, place in places.items():
            for name in sorted(_local_files(place)):
                if not stores.stays_inside(name) or (
                    not prefix and name.startswith((stores.OWN_PREFIX, stores.FINISHED, stores.UNFINISHED))
                ):
                    raise StorageError(f"{place / name}: has a name that cannot be stored at {self.store.url}.")
                size, sha256 = self._described(prefix + name, place / name)
                found[prefix + name] = stores.StoredFile(size=size, sha256=sha256)
        return dict(sorted(found.items()))

    def _described(self, name: str, path: Path) -> tuple[int, str]:
        """Size and digest of a file; hashed only if it has changed since."""
        status = _status(path)
        if name not in self.digests or self.digests[name][0] != status:
            self.digests[name] = (status, file_digest(path))
        return status[0], self.digests[name][1]


def _contents(files: Mapping[str, stores.StoredFile]) -> dict[str, str]:
    return {name: file.sha256 for name, file in files.items()}


def _placed(files: Mapping[str, stores.StoredFile], taken: Mapping[str, str]) -> dict[str, stores.StoredFile]:
    """Choose an object for each file: its own name, or another where that one holds another content.

    Args:
        files: Maps names to files.
        taken: Digests of the objects that are there, and must stay as they are.
    """
    placed = {}
    for name, file in files.items():
        beside = f"{stores.OWN_PREFIX}{file.sha256[:16]}/{name}"
        moves = taken.get(beside) == file.sha256 or taken.get(name, file.sha256) != file.sha256
        placed[name] = msgspec.structs.replace(file, object=beside) if moves else file
    return placed


def _local_files(folder: Path) -> dict[str, _Status]:
    """Sizes and times of all files below a folder by relative path, but for those that are being written."""
    found = {}
    for place, folders, files in os.walk(folder):
        folders[:] = [each for each in folders if not _PASSING.match(each)]
        paths = [Path(place, file) for file in files if not _PASSING.match(file)]
        found |= {path.relative_to(folder).as_posix(): _status(path) for path in paths}
    return found


def _status(path: Path) -> _Status:
    status = path.stat()
    return status.st_size, status.st_mtime_ns
