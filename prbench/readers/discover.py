"""Find every dataset below a folder that some reader recognises, without reading a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.datasets import installed_readers, origin_of, readable_datasets
from prbench.errors import InputFileError, PrbenchError, UnforeseenInput
from prbench.files.bounded import foreign_input, require
from prbench.protocol.manifests import load_manifest
from prbench.readers import SYNTHETIC_FILE, Reader, RecordingFiles, read_synthetic_tree, reader_for
from prbench.readers.found import names_in


@dataclass(frozen=True)
class FoundDataset:
    """One dataset in a folder.

    Attributes:
        dataset: Name of its reader.
    """

    dataset: str
    root: Path
    recordings: tuple[RecordingFiles, ...]

    @property
    def name(self) -> str:
        """Name that a build gives it: ``synthetic-`` stands before that of invented recordings."""
        return self.recordings[0].dataset


@dataclass(frozen=True)
class BrokenDataset:
    """A folder that a reader recognises as its own and cannot list.

    Attributes:
        dataset: Name of the dataset that it looks like.
        root: The folder.
        message: What is wrong.
    """

    dataset: str
    root: Path
    message: str


@dataclass(frozen=True)
class Discovery:
    """Everything that was recognised below a folder."""

    found: tuple[FoundDataset, ...]
    broken: tuple[BrokenDataset, ...]


@foreign_input()
def discover(root: Path | str) -> Discovery:
    """Ask every reader about a folder, and those that find nothing about each of its sub-folders.

    Raises:
        InputFileError: if the folder does not exist, or no reader recognises anything in it.
    """
    root = Path(root)
    if not root.is_dir():
        raise InputFileError(root, "", expected="a folder", found="a file" if root.is_file() else "nothing")
    found: list[FoundDataset] = []
    broken: list[BrokenDataset] = []
    readers, unusable = usable_readers()
    for reader in readers:
        dataset = reader.dataset
        for folder in (root, *_subfolders(root)):
            # Below the root only what lies in no recording of another dataset, and only if this one is not at the root.
            inside = (folder.is_relative_to(recording.folder) for other in found for recording in other.recordings)
            at_root = (other.dataset == dataset and other.root == root for other in found)
            if folder != root and (any(inside) or any(at_root)):
                continue
            answer = _ask(reader, folder)
            if isinstance(answer, BrokenDataset):
                if all(answer.message != other.message for other in broken):  # a damaged mark, told to every reader
                    broken.append(answer)
            elif answer is not None:
                found.append(answer)
    expected = f"recordings of {', '.join(reader.dataset for reader in readers)}, here or one folder below"
    remedy = " ".join(["`prbench datasets` says which files each dataset consists of.", *unusable])
    require(root, (found or broken, "", expected, names_in(root), remedy))
    return Discovery(tuple(sorted(found, key=lambda each: (each.dataset, str(each.root)))), tuple(broken))


def usable_readers() -> tuple[tuple[Reader, ...], tuple[str, ...]]:
    """Import every reader.

    Returns:
        The readers by name, and one message for each that a package offers and that cannot be used.
    """
    readers = []
    unusable = [f"{origin_of(reader)}: {reader.problem}." for reader in installed_readers() if reader.problem]
    for dataset in readable_datasets():
        try:
            load_manifest(dataset)
            readers.append(reader_for(dataset))
        except PrbenchError as error:
            unusable.append(str(error))
    return tuple(readers), tuple(unusable)


def _ask(reader: Reader, folder: Path) -> FoundDataset | BrokenDataset | None:
    """Ask one reader about one folder; None if the folder holds nothing of its dataset."""
    try:
        tree = read_synthetic_tree(folder)
        if tree is not None and tree.preset != reader.dataset:
            return None
        if tree is None and any((below / SYNTHETIC_FILE).is_file() for below in _subfolders(folder)):
            return None  # a folder of synthetic trees is none itself; each carries its own mark and splits
        with foreign_input(folder):
            recordings = reader.find(folder)
    except InputFileError as error:
        # A reader that found nothing names the folder, or the file in it that would mark the dataset; one that
        # stumbled names a file that is there, or one farther down.
        places = (folder, folder.expanduser().resolve())
        nothing = error.path in places or (error.path.parent in places and not error.path.exists())
        nothing = nothing and not isinstance(error, UnforeseenInput)
        return None if nothing else BrokenDataset(reader.dataset, folder, str(error))
    except PrbenchError as error:
        return BrokenDataset(reader.dataset, folder, str(error))
    return FoundDataset(reader.dataset, folder, recordings) if recordings else None


def _subfolders(root: Path) -> list[Path]:
    return sorted(entry for entry in root.iterdir() if entry.is_dir() and not entry.name.startswith("."))
