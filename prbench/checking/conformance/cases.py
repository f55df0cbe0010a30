"""The sequences that a method of prime-and-reach is asked about: of a table, or of synthetic people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prbench.harness.conditions import ConditionSource
from prbench.harness.planning import rows_of, select
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.sequences import SequenceTable
from prbench.sequences.dataset_info import FILE_NAME as INFO_FILE

SEQUENCES = 12  # that a method is asked about, unless it is slow
_SEED = 2024  # differs from that of the embedded tables, whose people a method may have learnt from
_EVENTS = 8
RECORDINGS = (0, 1, 2, 10)  # numbers of two people to learn from, and of two others (1 and 10) to be asked about


@dataclass(frozen=True)
class Cases:
    """The sequences that methods are asked about, sorted by length.

    Attributes:
        folder: The dataset, from whose training split methods learn.
    """

    source: ConditionSource
    folder: Path


def cases_of_table(folder: Path, limit: int = SEQUENCES) -> Cases:
    """Choose twelve test sequences of a table, as ``--limit`` chooses them.

    Raises:
        TableError: if there is no such table, or it has no test sequences.
    """
    source = ConditionSource.read(select(SequenceTable.open(folder).with_sequences(), split="test", limit=limit))
    return Cases(rows_of(source, np.argsort(source.n_frames, kind="stable")), folder)


def synthetic_cases(folder: Path, limit: int = SEQUENCES) -> Cases:
    """Choose twelve test sequences of synthetic people, the same in every process.

    The first process of a check acts them out, with ideal sensors, and later ones read their table.

    Args:
        folder: Folder of this check alone.
        limit: Number of sequences.
    """
    table = folder / "table"
    if not (table / INFO_FILE).is_file():
        write_synthetic_table(table)
    return cases_of_table(table, limit)


def write_synthetic_table(folder: Path, recordings: Sequence[int] = RECORDINGS) -> Path:
    """Write a table of synthetic people with ideal sensors, seven sequences a recording."""
    build_synthetic_table("adt", recordings, _SEED, folder, n_events=_EVENTS, noise=0.0, provocations={})
    return folder
