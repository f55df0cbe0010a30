"""``corpus.json``: what a built corpus is, where it came from and under which terms it may be used."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.sequences.info_file import Provenance, read_info
from prbench.storage import write_json

CORPUS_FILE = "corpus.json"


class CorpusCounts(msgspec.Struct, frozen=True, kw_only=True):
    """How many recordings, texts and clips each stage left."""

    recordings_found: int
    recordings_read: int
    recordings_failed: int
    recordings_skipped: int
    annotations: int
    """Texts of the source, empty ones included."""
    clips: int
    captions: int
    approximate_clips: int
    """Clips whose text was placed by aligning starts alone."""
    frames: int


class CorpusInfo(Provenance, frozen=True, kw_only=True):
    """Provenance of one built corpus; its outcomes are those of annotations."""

    counts: CorpusCounts

    def write(self, folder: Path) -> None:
        """Write ``corpus.json``."""
        write_json(folder / CORPUS_FILE, msgspec.to_builtins(self))

    @classmethod
    def read(cls, folder: Path | str) -> CorpusInfo:
        """Read ``corpus.json``.

        Raises:
            TableError: if the folder holds none, or it is damaged or of another version.
        """
        return read_info(Path(folder) / CORPUS_FILE, cls, what="corpus")
