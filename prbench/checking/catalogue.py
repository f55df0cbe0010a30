"""The catalogue of datasets: what each asks for, what of it lies below a folder, and what a built table must cite."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import msgspec

import prbench
from prbench.checking.inspection import look, missing_files
from prbench.datasets import own_datasets, readable_datasets
from prbench.errors import UsageError, did_you_mean
from prbench.protocol.manifests import dataset_names, load_citations, load_manifest
from prbench.readers import reader_for
from prbench.readers.discover import Discovery, usable_readers
from prbench.sequences import CorpusTable, SequenceTable
from prbench.sequences.dataset_info import CORPUS_FILE
from prbench.shown import clean

_TERMS = {
    "none": "must not be passed on in any form, derived data included, without permission of its owners",
    "non-commercial": "may be used and passed on for non-commercial purposes only, under the same licence",
    "yes": "may be passed on under its licence",
}


_OF_THE_MANIFEST = (
    *("name", "kind", "title", "homepage", "licence", "redistribution", "how_to_obtain"),
    *("required_files", "optional_files", "rates_hz", "known_bad"),
)


class CatalogueEntry(msgspec.Struct, frozen=True, kw_only=True):
    """One dataset that prbench can read, and what was found of it.

    Attributes:
        name: Name by which commands call it, such as ``adt``.
        kind: ``benchmark`` for sequences, ``corpus`` for pre-training.
        title: Its title.
        homepage: Address of its page.
        licence: Its licence.
        redistribution: Whether data made from it may be passed on: ``yes``, ``non-commercial`` or ``none``.
        how_to_obtain: What to do to get it.
        required_files: Files without which a recording is not read.
        optional_files: Files that add to a recording.
        rates_hz: Samples a second of each of its streams.
        known_bad: Recordings that are left out, and why.
        citation: What to cite, as BibTeX.
        body_poses: Sources that its bodies can come from.
        reader_options: Options of its reader, with their defaults.
        found: Places and counts of recordings below ``--root``; empty where nothing was looked for or found.
        missing: Required files that recordings below ``--root`` lack, and what else is wrong with them.
    """

    name: str
    kind: str
    title: str
    homepage: str
    licence: str
    redistribution: str
    how_to_obtain: str
    required_files: tuple[str, ...]
    optional_files: tuple[str, ...]
    rates_hz: dict[str, float]
    known_bad: dict[str, str]
    citation: str
    body_poses: tuple[str, ...]
    reader_options: tuple[str, ...]
    found: str
    missing: tuple[str, ...]


class Catalogue(msgspec.Struct, frozen=True, kw_only=True):
    """The catalogue of datasets, or the citations of tables.

    Attributes:
        datasets: One entry for each dataset, or the one that was named.
        unusable_readers: Installed packages whose reader cannot be used, and why.
        bibtex: BibTeX entries, with ``--cite``; the licence terms of each dataset stand above them as comments.
    """

    datasets: tuple[CatalogueEntry, ...] = ()
    unusable_readers: tuple[str, ...] = ()
    bibtex: str = ""


def catalogue(root: Path | None = None, name: str | None = None) -> tuple[CatalogueEntry, ...]:
    """List all datasets, or one of them.

    Args:
        root: Folder with copies, itself or one folder below; nothing is looked for if None.
        name: Only this dataset.

    Raises:
        UsageError: for an unknown name, with the nearest known one.
        InputFileError: if ``root`` does not exist or holds no dataset.
    """
    # Readers of other packages are listed beside ours; HumanML3D and Nymeria are ours but have no reader.
    names = tuple(sorted({*own_datasets(), *(reader.dataset for reader in usable_readers()[0])}))
    if name is not None:
        if name not in dataset_names():
            hint = did_you_mean(name, names)
            raise UsageError(f"unknown dataset '{name}'.{hint} Known ones are: {', '.join(names)}.")
        names = (name,)
    discovery, corpora = (Discovery((), ()), ()) if root is None else look(root)
    readable = readable_datasets()
    entries = []
    for dataset in names:
        here = [each for each in discovery.found if each.dataset == dataset]
        places = [(len(each.recordings), each.root) for each in here]
        places += [(len(found), folder) for corpus, folder, found in corpora if corpus == dataset]
        manifest = load_manifest(dataset)
        missing = [each.message for each in discovery.broken if each.dataset == dataset]
        recordings = [recording for each in here for recording in each.recordings]
        lacking = Counter(file for each in recordings for file in missing_files(each, manifest.required_roles))
        for file, count in sorted(lacking.items()):
            where = f"{count} of {len(recordings)} recordings (`prbench inspect` names them)"
            missing.append(f"{file} is missing in {where}")
        options = reader_for(dataset).options if dataset in readable else None
        values = {} if options is None else {option: getattr(options, option) for option in options.names()}
        defaults = {option: "none" if value is None else value for option, value in values.items()}
        entries.append(
            CatalogueEntry(
                **{name: getattr(manifest, name) for name in _OF_THE_MANIFEST},
                citation=manifest.citation.strip(),
                body_poses=tuple(body.pose_source for body in (manifest.body, *manifest.other_bodies.values())),
                reader_options=tuple(f"{option} (default {value})" for option, value in defaults.items()),
                found="; ".join(f"{number} recordings in {folder}" for number, folder in places),
                missing=tuple(missing),
            )
        )
    return tuple(entries)


def citation_text(folders: Sequence[Path]) -> str:
    """Return BibTeX of everything in some built datasets, with their terms as comments.

    Raises:
        TableError: if a folder holds no built dataset, or one of which a file was edited.
    """
    terms = []
    entries = []
    for folder in folders:
        is_corpus = (folder / CORPUS_FILE).is_file()
        info = (CorpusTable if is_corpus else SequenceTable).open(folder).info
        terms.append(f"% {clean(info.dataset)}: {clean(info.title)}")
        terms.append(f"%   licence: {clean(info.licence)}")
        terms.append(f"%   it {clean(_TERMS.get(info.redistribution, info.redistribution))}.")
        if info.homepage:
            terms.append(f"%   {clean(info.homepage)}")
        # Each entry starts with ``@`` at the beginning of a line.
        entries += [entry.strip() for entry in re.split(r"^(?=@)", info.citation, flags=re.MULTILINE) if entry.strip()]
    common = load_citations()
    toolkit = common["toolkit"].replace("VERSION", prbench.__version__)
    everything = dict.fromkeys([*entries, common["study"].strip(), toolkit.strip()])  # imports cite the study, too
    return "\n\n".join(["\n".join(terms), *everything])
