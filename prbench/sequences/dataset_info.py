"""``dataset.json`` and ``corpus.json``: what a table is, where it came from, under which terms it may be used."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol, Self, runtime_checkable

import msgspec

import prbench
from prbench.errors import RedistributionError, TableError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import is_path_part, write_json
from prbench.limits import LARGEST_JSON
from prbench.shown import quoted

FILE_NAME = "dataset.json"
CORPUS_FILE = "corpus.json"


# What is built, by the file that describes it, for messages.
_KINDS = {
    FILE_NAME: "a built dataset",
    CORPUS_FILE: "a corpus",
    "tracks.json": "a table of tracks, which `prbench run --benchmark three-points` takes",
    "windows.json": "a table of windows, which `prbench run --benchmark motion-prediction` takes",
    "shard.json": "a shard, which `prbench merge` puts together with the others",
}


# A number of things, or of a version; no table has more.
Count = Annotated[int, msgspec.Meta(ge=0, le=10**12)]


class QuarantinedRecording(msgspec.Struct, frozen=True, kw_only=True):
    """A recording that was left out, and why.

    Attributes:
        recording_id: Name of the recording.
        status: ``failed`` or ``skipped``.
        message: Why.
    """

    recording_id: str
    status: str
    message: str


def quarantined(records: Iterable[Any]) -> tuple[QuarantinedRecording, ...]:
    """Return those of the records that were not read."""
    names = QuarantinedRecording.__struct_fields__
    left_out = (each for each in records if each.status != "read")
    return tuple(QuarantinedRecording(**{name: getattr(each, name) for name in names}) for each in left_out)


def begun_with(protocol: Any) -> dict[str, Any]:
    """Return the fields that every description begins with; whoever writes the tables fills in their digests."""
    versions = {"protocol_version": protocol.version, "prbench_version": prbench.__version__}
    return {**versions, "protocol_digest": protocol.digest, "identity_digest": "", "content_digest": ""}


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """The description of every built table. Holds no time of day, host, absolute path or worker count.

    Subclasses name the file that holds it in the folder of the table (``file_name``), what is built for messages
    (``described``: ``dataset``, ``corpus`` or ``table of windows``), and the command that builds it.

    Attributes:
        schema_version: Version of the table.
        protocol_version: Version of the protocol.
        protocol_digest: Digest of the rules that it was built by.
        dataset: Name of the dataset; ``synthetic-`` stands before that of synthetic people.
        title: Its title.
        synthetic: The people are synthetic.
        prbench_version: Version of prbench that built it.
        manifest_digest: Digest of the dataset's manifest.
        input_digest: Over the names and contents of all files that were used.
        options: Options of the build by name.
        outcomes: Number of events (in a corpus: texts, of windows: windows) by what became of them.
        quarantine: Recordings that could not be read or are known to be bad.
        identity_digest: Digest of its ids.
        content_digest: Digest of its content.
        file_digests: SHA-256 of each Parquet file beside this one, by relative path; empty in tables of earlier
            versions.
        licence: Licence of the data.
        redistribution: Whether data made from it may be passed on: ``yes``, ``non-commercial`` or ``none``.
        homepage: Homepage of the dataset.
        citation: BibTeX of what is to be cited.
    """

    schema_version: Count
    protocol_version: Count
    protocol_digest: str
    dataset: str
    title: str
    synthetic: bool
    prbench_version: str
    manifest_digest: str
    input_digest: str
    options: dict[str, str]
    outcomes: dict[str, Count]
    quarantine: tuple[QuarantinedRecording, ...]
    identity_digest: str
    content_digest: str
    file_digests: dict[str, str] = {}
    licence: str
    redistribution: str
    homepage: str
    citation: str
    file_name: ClassVar[str]
    described: ClassVar[str]
    build_command: ClassVar[str]

    def write(self, folder: Path) -> None:
        """Write the file of this description."""
        write_json(folder / self.file_name, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, folder: Path | str) -> Self:
        """Read the file that describes a built dataset or corpus.

        Raises:
            TableError: if the folder holds none, or it is damaged or of another version.
        """
        folder = Path(folder)
        path = folder / cls.file_name
        try:
            info = msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=cls)
        except (FileNotFoundError, NotADirectoryError) as error:
            why = f"(a folder with {cls.file_name}), found {_found(folder)}. {cls._remedy(folder)}"
            raise TableError(f"{folder}: expected a built {cls.described} {why}") from error
        except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError) as error:
            raise TableError(f"{path}: not a valid {path.name}: {error}. Build the {cls.described} again.") from error
        if not is_path_part(info.dataset):  # folders are named after it, and nothing is made before this is known
            found = f"'{quoted(info.dataset)}'. Build the {cls.described} again."
            raise TableError(f"{path}, dataset: expected a name that a folder can have, found {found}")
        return info

    @classmethod
    def _remedy(cls, folder: Path) -> str:
        """Name the built ones one folder farther down, or beside a missing one those with its name in theirs."""
        near = sorted(str(file.parent) for file in folder.glob(f"*/{cls.file_name}"))
        if not folder.exists() and folder.parent.is_dir():
            beside = sorted(file.parent for file in folder.parent.glob(f"*/{cls.file_name}"))
            close = difflib.get_close_matches(folder.name, [other.name for other in beside])
            near = [str(other) for other in beside if folder.name in other.name or other.name in close]
        return f"Did you mean {', '.join(near)}?" if near else f"Make one with `prbench {cls.build_command}`."


def _found(folder: Path) -> str:
    for name, kind in _KINDS.items():
        if (folder / name).is_file():
            return kind
    if folder.is_dir():
        return "no such file in it"
    return "a file" if folder.is_file() else "no such folder"


class FunnelCounts(msgspec.Struct, frozen=True, kw_only=True):
    """Numbers of candidates that each stage left.

    Attributes:
        recordings_found: Recordings in the copy of the dataset.
        recordings_read: Those that could be read.
        recordings_failed: Those that could not.
        recordings_skipped: Those that are known to be bad.
        recordings_cut_short: Those among the read ones of which a stream ends too early; 0 in older tables.
        events: Candidate events.
        located: Events whose place is known.
        primed: Events at whose place gaze looked before.
        long_enough: Events that recording and body cover.
        moved_enough: Events before which the body moved.
        sequences: Events that became a sequence.
    """

    recordings_found: Count
    recordings_read: Count
    recordings_failed: Count
    recordings_skipped: Count
    recordings_cut_short: Count = 0
    events: Count
    located: Count
    primed: Count
    long_enough: Count
    moved_enough: Count
    sequences: Count


class DatasetInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one built dataset; its outcomes are those of events.

    Attributes:
        counts: How many recordings and events each stage of curation left.
    """

    file_name = FILE_NAME
    described = "dataset"
    build_command = "build-dataset"

    counts: FunnelCounts

    @property
    def why_not_scored(self) -> str | None:
        """Why no metric may be computed on this dataset, or None: an import may not know the frame of its goals."""
        if self.options.get("goal_frame") == "unknown":
            sentence = "it was imported from a release whose goals are in an unknown frame (import_report.json has the"
            return f"{sentence} evidence), so no distance to a goal means anything"
        return None


class CorpusCounts(msgspec.Struct, frozen=True, kw_only=True):
    """Numbers of recordings, texts and clips that each stage left.

    ``annotations`` are the texts of the source, empty ones included; ``approximate_clips`` are those whose text was
    placed by aligning starts alone.
    """

    recordings_found: Count
    recordings_read: Count
    recordings_failed: Count
    recordings_skipped: Count
    annotations: Count
    clips: Count
    captions: Count
    approximate_clips: Count
    frames: Count


class CorpusInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one built corpus; its outcomes are those of annotations."""

    file_name = CORPUS_FILE
    described = "corpus"
    build_command = "build-corpus"

    counts: CorpusCounts


# Stands beside recorded motion that leaves a table.
NOTICE_FILE = "NOTICE.txt"

_STRICTEST_FIRST = ("none", "non-commercial", "yes")


@runtime_checkable
class _HasTerms(Protocol):
    """Anything that says under which terms a dataset's recordings stand (``DatasetInfo``, ``TableRecord`` …)."""

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        ...

    @property
    def title(self) -> str:
        """Its title, for people."""
        ...

    @property
    def redistribution(self) -> str:
        """``none``, ``non-commercial`` or ``yes``; anything else counts as ``none``."""
        ...


def may_pass_on(terms: _HasTerms, permitted: Collection[str] = (), *, published: bool = False) -> bool:
    """Return True if recorded motion and goal poses may stand in a view or export.

    Args:
        terms: Terms of the dataset.
        permitted: Datasets for which the user has the licensor's permission, by name.
        published: It is made to be published, so that a use for non-commercial purposes alone cannot be seen to.
    """
    kind = _known(terms.redistribution)
    return kind == "yes" or terms.dataset in permitted or (kind == "non-commercial" and not published)


def require_may_pass_on(
    terms: _HasTerms, what: str, permitted: Collection[str] = (), *, published: bool = False
) -> None:
    """Refuse to write what the licence keeps.

    Args:
        terms: Terms of the dataset.
        what: What would be written, for the message.
        permitted: See :func:`may_pass_on`.
        published: See there.

    Raises:
        RedistributionError: if the licence forbids it and no permission is stated.
    """
    if not may_pass_on(terms, permitted, published=published):
        kept = "be passed on" if _known(terms.redistribution) == "none" else "be published for any purpose"
        why = f"its licence does not let recorded motion and goal poses {kept}, and {what} would hold them."
        remedy = f"If the licensor has given you permission, say so: --permission {terms.dataset}"
        raise RedistributionError(f"{terms.title} ({terms.dataset}): {why} {remedy}")


def notice(terms: _HasTerms, permitted: Collection[str] = ()) -> str:
    """Return the sentence that views and exports of the dataset carry; empty where nothing has to be said."""
    if _known(terms.redistribution) == "yes":
        return ""
    if terms.redistribution == "non-commercial":
        return f"{terms.title}: for non-commercial purposes only, under the dataset's own licence."
    if terms.dataset in permitted:
        return f"{terms.title}: holds recorded motion by permission that the user states; do not pass it on further."
    return f"{terms.title}: recorded motion and goal poses must not be passed on; left out here."


def run_notice(terms: _HasTerms, *, recorded_motion: bool) -> str:
    """Return the notice of a run folder about the motions in it; empty where nothing has to be said.

    A run stays with whoever has the data, so nothing is refused; passing the folder on is the user's act.

    Args:
        terms: Terms of the dataset that was run on.
        recorded_motion: The predictions are the recorded motion itself (the ground-truth control).
    """
    kind = _known(terms.redistribution)
    if kind == "yes":
        return ""
    held = "the recorded motion itself" if recorded_motion else "motions generated from recorded goals and first poses"
    if kind == "non-commercial":
        return f"{terms.title}: the predictions are {held}; for non-commercial purposes only.\n"
    rule = "they must not leave your machine" if recorded_motion else "recorded poses in them must not be passed on"
    return f"{terms.title}: the predictions are {held}; {rule} without the licensor's permission. Scores may.\n"


def strictest(redistributions: Iterable[str]) -> str:
    """Return the terms of data that stand under several licences at once."""
    return min((_known(kind) for kind in redistributions), key=_STRICTEST_FIRST.index, default="none")


def _known(redistribution: str) -> str:
    """Return the kind, or the strictest one for a word that is not known."""
    # A word from a newer version may forbid more than this one knows.
    return redistribution if redistribution in _STRICTEST_FIRST else "none"
