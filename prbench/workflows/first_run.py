"""The embedded default, used when no data is given: a small synthetic dataset, and the methods compared with on it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import prbench
from prbench.contract import Condition
from prbench.engine import Engine
from prbench.evaluation.controls import GROUND_TRUTH, SCRIPTED
from prbench.evaluation.request import RunRequest
from prbench.locks import in_turn
from prbench.manifests import digest_of, load_manifest, load_protocol
from prbench.methods.installed import list_adapters
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME
from prbench.sequences.schema import SCHEMA_VERSION
from prbench.storage import cache_folder, text_digest
from prbench.synthetic import GENERATOR_VERSION

if TYPE_CHECKING:
    from prbench.workflows.synthetic_table import Progress

_PRESET = "adt"
RECORDINGS = 40
SEED = 0
SEQUENCES = 48
"""Number of test sequences that a first run generates, unless the user names another."""
BATCH_SIZE = 12
"""Sequences a batch in a first run: small enough that two workers share the work."""
_COMPANIONS = (("mdm", Condition.TEXT), (SCRIPTED, None), ("static", Condition.NONE), (GROUND_TRUTH, None))
"""Methods beside which a first run is shown, and their condition; None takes the run's own."""


def default_table_folder() -> Path:
    """Folder of the embedded dataset; another version of prbench, generator, protocol or schema gets another one."""
    # Everything that the table's bytes depend on, so that no version reads the table of another.
    key = text_digest(
        prbench.__version__,
        str(GENERATOR_VERSION),
        str(SCHEMA_VERSION),
        load_protocol().digest,
        digest_of(load_manifest(_PRESET)),
    )
    return cache_folder() / "tables" / f"synthetic-{_PRESET}-{RECORDINGS}-{key[:12]}"


def default_table(engine: Engine, progress: Progress, tell: Callable[[str], None] = lambda _: None) -> SequenceTable:
    """Open the embedded dataset, building it first where it is not there yet.

    Args:
        engine: Where it is built.
        progress: Called after each recording.
        tell: Called with a line that names the process which is building it meanwhile, and is waited for.
    """
    folder = default_table_folder()
    if not (folder / FILE_NAME).is_file():
        _build_once(folder, engine, progress, tell)
    return SequenceTable.open(folder)


def _build_once(folder: Path, engine: Engine, progress: Progress, tell: Callable[[str], None]) -> None:
    from prbench.workflows.synthetic_table import build_synthetic_table  # every later run goes without it

    with in_turn(folder.with_name(f"{folder.name}.first-run"), tell):  # the build itself holds the folder
        if not (folder / FILE_NAME).is_file():
            build_synthetic_table(
                _PRESET, recordings=RECORDINGS, seed=SEED, out=folder, engine=engine, progress=progress
            )


def companions(request: RunRequest) -> Iterator[RunRequest]:
    """Yield runs of the same sequences for controls and recorded motion, as far as their methods are installed.

    The controls are text alone, constant timing and a mean pose. A run of one of them has no companions.
    """
    # A run of a companion, of shuffled goals or of chosen sequences is not a first look at a method.
    if request.method in {name for name, _ in _COMPANIONS} or request.control is not None or request.sequences:
        return
    there = {SCRIPTED, GROUND_TRUTH, *(adapter.name for adapter in list_adapters() if adapter.built_in)}
    for method, condition in _COMPANIONS:
        if method not in there:
            continue
        # The companions see the same sequences, but nothing that belongs to the user's own method.
        yield replace(
            request,
            method=method,
            condition=condition or request.condition,
            weights=None,
            options={},
            out=None,
            isolate=False,
            timeout=None,
        )
