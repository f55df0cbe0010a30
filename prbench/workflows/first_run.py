"""The embedded default: a small synthetic dataset in the user's cache, built when no data is given."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import prbench
from prbench.engine import Engine
from prbench.evaluation.cache import cache_folder
from prbench.manifests import digest_of, load_manifest, load_protocol
from prbench.sequences import SequenceTable
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.storage import text_digest
from prbench.synthetic import GENERATOR_VERSION

if TYPE_CHECKING:
    from prbench.workflows.synthetic_table import Progress

PRESET = "adt"
RECORDINGS = 40
SEED = 0


def default_table_folder() -> Path:
    """Folder of the embedded dataset; another version of prbench, generator, protocol or schema gets another one."""
    key = text_digest(
        prbench.__version__,
        str(GENERATOR_VERSION),
        str(SCHEMA_VERSION),
        load_protocol().digest,
        digest_of(load_manifest(PRESET)),
    )
    return cache_folder() / "tables" / f"synthetic-{PRESET}-{RECORDINGS}-{key[:12]}"


def default_table(engine: Engine, progress: Progress) -> SequenceTable:
    """Open the embedded dataset, building it first where it is not there yet."""
    folder = default_table_folder()
    if not (folder / "dataset.json").is_file():
        from prbench.workflows.synthetic_table import build_synthetic_table  # every later run goes without it

        build_synthetic_table(PRESET, recordings=RECORDINGS, seed=SEED, out=folder, engine=engine, progress=progress)
    return SequenceTable.open(folder)
