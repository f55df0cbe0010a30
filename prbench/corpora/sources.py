"""Where a corpus takes its recordings from. A new corpus is a new module with a ``CORPUS`` and one line here."""

from __future__ import annotations

import fnmatch
import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from prbench.corpora.options import CorpusOptions
from prbench.errors import InputFileError, UsageError
from prbench.manifests import Manifest
from prbench.sequences.corpus import Annotation, Clip
from prbench.storage import text_digest

CORPUS_MODULES = {
    "nymeria": "prbench.corpora.nymeria",
    "humanml3d": "prbench.corpora.humanml3d",
    "synthetic": "prbench.synthetic.corpus",
}


@dataclass(frozen=True)
class Belonging:
    """What is known of a recording before it is read."""

    dataset: str
    """Name that the clips will carry; ``synthetic-`` before it for invented people."""
    recording_id: str
    participant_id: str
    split: str
    split_group: str


@dataclass(frozen=True)
class Cost:
    """What one recording costs, for the dry run; rates were measured on synthetic files, one core."""

    input_bytes: int
    seconds: float
    disk_bytes: float
    """Of its rows in the table and in the parts that the table is made from."""


@dataclass(frozen=True)
class ReadRecording:
    """What reading one recording gave."""

    clips: tuple[Clip, ...]
    annotations: tuple[Annotation, ...]
    duration: float
    """Seconds of usable motion."""
    clock_method: str = "same"
    """How text and motion were brought onto one clock; ``same`` where they share one."""
    clock_quality: float | None = None
    message: str = ""
    measured: tuple[tuple[str, str], ...] = ()


@runtime_checkable
class CorpusRecording(Protocol):
    """One recording that can be read, here or in another process; instances are picklable."""

    @property
    def belonging(self) -> Belonging:
        """Name, participant and split."""
        ...

    @property
    def skip_reason(self) -> str | None:
        """Why the recording must not be read; None for all that are fine."""
        ...

    @property
    def cost(self) -> Cost:
        """About what reading it takes."""
        ...

    def input_digest(self) -> str:
        """Digest of everything that reading depends on, apart from the options."""
        ...

    def read(self) -> ReadRecording:
        """Read it."""
        ...

    def without_places(self, message: str) -> str:
        """A message without the folders of this machine."""
        ...


@dataclass(frozen=True)
class RecordingGroup:
    """Recordings that are worked on and kept together: tiny ones by the hundred, large ones alone."""

    name: str
    recordings: tuple[CorpusRecording, ...]

    def input_digest(self) -> str:
        """Of all members."""
        return text_digest(*(recording.input_digest() for recording in self.recordings if not recording.skip_reason))


@runtime_checkable
class Corpus(Protocol):
    """One kind of corpus."""

    @property
    def manifest(self) -> Manifest | None:
        """Origin and licence; None for what prbench itself invents."""
        ...

    def described(self, options: CorpusOptions) -> dict[str, str]:
        """The corpus' own options as text, without places of this machine.

        Raises:
            UsageError: for an option that it does not know, or a rate that it cannot give.
        """
        ...

    def find(self, root: Path | None, options: CorpusOptions) -> tuple[CorpusRecording, ...]:
        """All recordings below a folder.

        Raises:
            UsageError: for an option that the corpus does not know.
            InputFileError: if there is nothing to read.
        """
        ...

    def group_of(self, recording_id: str) -> str:
        """Name of the group to which a recording belongs."""
        ...


def corpus_for(name: str) -> Corpus:
    """The corpus of one name.

    Raises:
        UsageError: for an unknown one, naming those there are.
    """
    if name not in CORPUS_MODULES:
        raise UsageError(f"unknown corpus '{name}'; known ones are: {', '.join(CORPUS_MODULES)}.")
    return importlib.import_module(CORPUS_MODULES[name]).CORPUS


def find_groups(corpus: Corpus, root: Path | None, options: CorpusOptions) -> tuple[RecordingGroup, ...]:
    """The recordings that the options choose, in table order, by groups.

    Raises:
        InputFileError: if there is no recording, or none that matches the glob.
    """
    found = {each.belonging.recording_id: each for each in corpus.find(root, options)}
    groups: dict[str, list[CorpusRecording]] = {}
    for name in _chosen(list(found), options, where=root or "invented people"):
        groups.setdefault(corpus.group_of(name), []).append(found[name])
    return tuple(RecordingGroup(name, tuple(members)) for name, members in groups.items())


def _chosen(names: Sequence[str], options: CorpusOptions, *, where: Path | str) -> list[str]:
    chosen = sorted(name for name in names if fnmatch.fnmatchcase(name, options.recordings))
    if not chosen:
        shown = ", ".join(sorted(names)[:5]) + (" …" if len(names) > 5 else "")
        raise InputFileError(
            where,
            "",
            expected=f"recordings whose name matches '{options.recordings}'",
            found=f"{len(names)} others: {shown}",
            remedy="Change the glob of --recordings.",
        )
    return chosen[: options.limit]
