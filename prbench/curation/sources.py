"""The sources of a build's recordings: native files of a dataset, or anything else that yields recordings."""

from __future__ import annotations

import fnmatch
import os
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from prbench.curation.options import BuildOptions
from prbench.errors import InputFileError
from prbench.files.arrays import first_repeated
from prbench.files.bounded import foreign_input
from prbench.files.storage import text_digest
from prbench.protocol.manifests import load_manifest
from prbench.readers import (
    Reader,
    RecordingFiles,
    cut_short,
    described_options,
    read_synthetic_tree,
    reader_for,
    require_marked,
    require_one_origin,
)
from prbench.readers.parse_cache import remembered_digest
from prbench.recording import Recording


@runtime_checkable
class RecordingSource(Protocol):
    """One recording that can be read, here or in another process; instances are picklable."""

    @property
    def dataset(self) -> str:
        """Name of the dataset that the recording will carry."""
        ...

    @property
    def recording_id(self) -> str:
        """Unique within a build."""
        ...

    @property
    def split(self) -> str | None:
        """The split, where the source decides it; None = by the split rule."""
        ...

    @property
    def skip_reason(self) -> str | None:
        """The reason why the recording must not be read; None for all that are fine."""
        ...

    def input_digest(self) -> str:
        """Digest of everything that reading depends on."""
        ...

    def read(self) -> Recording:
        """Read it."""
        ...

    def without_places(self, message: str) -> str:
        """A message without the folders of this machine, so that equal inputs give equal datasets anywhere."""
        ...


@dataclass(frozen=True)
class NativeSource:
    """A recording in a dataset's own files."""

    root: Path
    """The folder that was searched."""
    found: RecordingFiles
    split: str | None
    skip_reason: str | None
    reader_options: tuple[tuple[str, str], ...] = ()
    """See :class:`prbench.curation.options.BuildOptions`."""

    @property
    def dataset(self) -> str:
        """See :class:`RecordingSource`."""
        return self.found.dataset

    @property
    def recording_id(self) -> str:
        """See :class:`RecordingSource`."""
        return self.found.recording_id

    @property
    def size(self) -> int:
        """Bytes of all input files."""
        return sum(file.size for file in self.found.files)

    @foreign_input()
    def input_digest(self) -> str:
        """See :class:`RecordingSource`: roles, names and contents of the files, a split of their own, and options."""
        files = sorted(self.found.files, key=lambda file: file.role)
        digests = {path: remembered_digest(path) for path in {file.path for file in files}}  # many lie in one archive
        parts = [text for file in files for text in (file.role, file.path.name, file.member, digests[file.path])]
        chosen = [text for item in described_options(self._reader.options).items() for text in item]
        return text_digest(self.dataset, self.recording_id, self.split or "", *parts, *chosen)

    @property
    def _reader(self) -> Reader:
        return reader_for(self.dataset, dict(self.reader_options))

    def read(self) -> Recording:
        """See :class:`RecordingSource`; streams that end before the recording does are named."""
        recording = self._reader.read(self.found)
        return replace(recording, shortfalls=cut_short(self.found, recording))

    def without_places(self, message: str) -> str:
        """See :class:`RecordingSource`."""
        root = self.root.expanduser().resolve()
        for folder in (root, root.parent):
            message = message.replace(f"{folder}{os.sep}", "")
        return message


@foreign_input()
def native_sources(dataset: str, root: Path | str, options: BuildOptions) -> tuple[NativeSource, ...]:
    """The recordings of a dataset's folder that the options choose, sorted by id.

    Raises:
        UsageError: for a dataset without a reader, or options that it cannot fulfil.
        InputFileError: if there is no recording, or none that matches the glob.
    """
    root = Path(root)
    reader = reader_for(dataset, dict(options.reader))
    manifest = load_manifest(reader.dataset)
    options.curation.require_fits(manifest)
    recordings = reader.find(root)
    repeated = first_repeated(recording.recording_id for recording in recordings)
    if repeated is not None:
        folders = [str(recording.folder) for recording in recordings if recording.recording_id == repeated]
        raise InputFileError(
            root,
            "",
            expected="recordings with different names",
            found=f"'{repeated}' in {' and '.join(folders)}",
            remedy="Move one of the two copies away.",
        )
    found = {recording.recording_id: recording for recording in recordings}
    require_one_origin(root, (recording.dataset for recording in found.values()))
    require_marked(root, {name: recording.dataset for name, recording in found.items()})
    tree = read_synthetic_tree(root)
    return tuple(
        NativeSource(
            root,
            found[name],
            tree.split.get(name) if tree else found[name].split,
            manifest.why_bad(name) or found[name].skip_reason,
            options.reader,
        )
        for name in chosen_ids(list(found), options, where=root)
    )


def chosen_ids(recording_ids: SequenceOf[str], options: BuildOptions, *, where: Path | str) -> list[str]:
    """Ids that match the glob, in table order, at most ``options.limit`` of them.

    Table order is that of ``recording_id + "/"``: sequence ids, which go on with a slash, then come out sorted.

    Raises:
        InputFileError: if none matches.
    """
    chosen = [name for name in recording_ids if fnmatch.fnmatchcase(name, options.recordings)]
    if not chosen:
        shown = ", ".join(sorted(recording_ids)[:5]) + (" …" if len(recording_ids) > 5 else "")
        raise InputFileError(
            where,
            "",
            expected=f"recordings whose name matches '{options.recordings}'",
            found=f"{len(recording_ids)} others: {shown}",
            remedy="Change the glob of --recordings.",
        )
    return sorted(chosen, key=lambda name: f"{name}/")[: options.limit]
