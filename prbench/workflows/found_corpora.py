"""Which corpora for pre-training lie below a folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from prbench.corpora.options import CorpusOptions
from prbench.corpora.sources import CORPUS_MODULES, CorpusRecording, corpus_for
from prbench.errors import PrbenchError


@dataclass(frozen=True)
class FoundCorpus:
    """One corpus in a folder."""

    corpus: str
    """Name under which it is built."""
    root: Path
    recordings: tuple[CorpusRecording, ...]

    @property
    def name(self) -> str:
        """Name that a build gives it: ``synthetic-`` stands before that of invented people."""
        return self.recordings[0].belonging.dataset


def find_corpora(root: Path) -> tuple[FoundCorpus, ...]:
    """Look for each corpus in the folder itself, and one folder below where there is nothing."""
    found = []
    for name in CORPUS_MODULES:
        if corpus_for(name).manifest is None:
            continue  # invented on the spot; nothing of it lies anywhere
        below = sorted(entry for entry in root.iterdir() if entry.is_dir() and not entry.name.startswith("."))
        for folder in (root, *below):
            try:
                recordings = corpus_for(name).find(folder, CorpusOptions())
            except PrbenchError:
                continue
            if recordings:
                found.append(FoundCorpus(name, folder, recordings))
                break
    return tuple(found)
