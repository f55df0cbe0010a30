"""Splits by participant: cross-validation in which nobody is learnt from and tested on.

Source: docs/specification/protocol.md#participant-folds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import prbench
from prbench.errors import TableError, UsageError, did_you_mean
from prbench.files.storage import cache_folder, in_turn, sole_writer, text_digest
from prbench.sequences import dataset_info, schema, write
from prbench.sequences.table import SequenceTable

_UNKNOWN = ("", "unknown")
# Stands in place of ``K/N`` for a run on all folds, one a participant.
ALL_FOLDS = "participant"
# Key of the options of a table that holds the fold, such as ``2/6``.
OPTION = "participant_fold"
# Key of the options of a table that holds the content digest of the whole table.
WHOLE_TABLE = "participant_fold_of"


def parse_fold(text: str) -> tuple[int, int]:
    """Return the number of a fold and the number of folds of a text such as ``2/6``.

    Raises:
        UsageError: for another text, or a fold that does not exist.
    """
    number, _, count = text.partition("/")
    # Few digits, so that no number is too long for Python to read.
    if not all(part.isdecimal() and len(part) <= 6 for part in (number, count)):
        meant = text == ALL_FOLDS or did_you_mean(text, (ALL_FOLDS,))
        alone = f" All folds together are `prbench run --folds {ALL_FOLDS}`'s." if meant else ""
        raise UsageError(f"--fold {text}: expected K/N, such as 2/6.{alone}")
    fold = int(number)
    folds = int(count)
    if folds < 2 or not 1 <= fold <= folds:
        raise UsageError(f"--fold {text}: expected K/N with N of at least 2 and K from 1 to N.")
    return fold, folds


def fold_tables(folders: Iterable[Path], fold: str | None) -> tuple[Path, ...]:
    """Return the folders of one fold of each table; it is written into prbench's cache where it is not there yet.

    Args:
        folders: The whole tables.
        fold: Such as ``2/6``; None for the tables themselves.

    Raises:
        UsageError: see :func:`write_fold`.
        TableError: see :func:`participant_folds`.
        StorageError: if the cache cannot be written.
    """
    if fold is None:
        return tuple(folders)
    number, count = parse_fold(fold)
    made = []
    for folder in folders:
        table = SequenceTable.open(folder).with_sequences()
        info = table.info
        # Everything that the fold's bytes depend on. Runs find their tables in this place of the cache.
        key = text_digest(prbench.__version__, str(schema.SCHEMA_VERSION), info.content_digest, info.protocol_digest)
        out = cache_folder() / "tables" / f"{info.dataset}-fold-{number}-of-{count}-{key[:12]}"
        with in_turn(out.with_name(f"{out.name}.fold")):  # writing holds the folder itself
            if not (out / dataset_info.FILE_NAME).is_file():
                write_fold(table, out, fold=number, folds=count)
        made.append(out)
    return tuple(made)


def participant_folds(table: SequenceTable, folds: int) -> dict[str, int]:
    """Assign every participant to a fold, from 1.

    Participants who were recorded together stay together. They are dealt out from the largest number of sequences to
    the smallest, each to the fold that has the fewest sequences so far, so that folds differ little.

    Args:
        table: The whole table.
        folds: Number of folds, 2 or more.

    Raises:
        TableError: if a participant is unknown, or there are fewer participants who were recorded apart than folds.
    """
    unit_of = participant_units(table)
    counts = Counter(unit_of[name] for name in table.scalars(columns=["participant_id"])["participant_id"].to_pylist())
    if len(counts) < folds:
        found = f"found {len(counts)}. Choose fewer folds: --fold 1/{max(len(counts), 2)}."
        raise TableError(f"{table.folder}: expected at least {folds} participants who were recorded apart, {found}")
    load = [0] * folds
    fold_of: dict[str, int] = {}
    for unit in sorted(counts, key=lambda unit: (-counts[unit], unit)):
        fold = load.index(min(load))
        load[fold] += counts[unit]
        fold_of[unit] = fold + 1
    return {name: fold_of[unit] for name, unit in unit_of.items()}


def participant_units(table: SequenceTable) -> dict[str, str]:
    """Map every participant to the first of those who were recorded together: the units that do not depend on others.

    Args:
        table: A whole table or a fold of one.

    Raises:
        TableError: if a participant is unknown.
    """
    rows = table.scalars(columns=["participant_id", "split_group"])
    people = rows["participant_id"].to_pylist()
    unknown = sum(name in _UNKNOWN for name in people)
    if unknown:
        found = f"{unknown} of {len(people)} without. Folds of participants need to know who is who."
        raise TableError(f"{table.folder}: expected a participant of every sequence, found {found}")
    names, place = np.unique(np.array(people, dtype=str), return_inverse=True)
    _, group = np.unique(np.array(rows["split_group"].to_pylist(), dtype=str), return_inverse=True)
    # Participants and split groups are the nodes of a graph, and each sequence is an edge between two of them.
    nodes = len(names) + len(set(group.tolist()))
    edges = coo_array((np.ones(len(place)), (place, len(names) + group)), shape=(nodes, nodes))
    component = connected_components(edges, directed=False)[1][: len(names)]
    return {str(name): str(min(names[component == each])) for name, each in zip(names, component)}


def tested_units(table: SequenceTable) -> dict[str, str]:
    """Map every recording that a fold tests on, as ``dataset/recording``, to its unit (:func:`participant_units`)."""
    unit_of = participant_units(table)
    rows = table.scalars(split="test", columns=["recording_id", "participant_id"])
    pairs = zip(rows["recording_id"].to_pylist(), rows["participant_id"].to_pylist())
    return {f"{table.info.dataset}/{name}": unit_of[person] for name, person in sorted(set(pairs))}


def write_fold(table: SequenceTable, out: Path, *, fold: int, folds: int) -> dataset_info.DatasetInfo:
    """Write a copy of a table that is split by participants: those of one fold are tested on, all others learnt from.

    Sequences of the others that stood in the split ``validation`` stay there. Nothing else changes, and the name of the
    fold stands in the options of ``dataset.json``.

    Args:
        table: The whole table.
        out: Folder of the copy.
        fold: Number of the fold, from 1 to ``folds``.
        folds: Number of folds.

    Raises:
        UsageError: for a fold that does not exist, or a table that is one fold already.
        TableError: see :func:`participant_folds`.
        StorageError: if the folder holds something else, or cannot be written.
    """
    parse_fold(f"{fold}/{folds}")
    if OPTION in table.info.options:
        raise UsageError(f"{table.folder}: is fold {table.info.options[OPTION]} already; name the whole table.")
    fold_of = participant_folds(table, folds)

    def split(batch: pa.RecordBatch) -> pa.RecordBatch:
        pairs = zip(batch["participant_id"].to_pylist(), batch["split"].to_pylist())
        kept = {"validation": "validation"}  # what is not tested on is learnt from, or stays apart
        new = ["test" if fold_of.get(person) == fold else kept.get(old, "train") for person, old in pairs]
        return batch.set_column(batch.schema.get_field_index("split"), batch.schema.field("split"), pa.array(new))

    names = table.schemas[table.main].names
    options = {**table.info.options, OPTION: f"{fold}/{folds}", WHOLE_TABLE: table.info.content_digest}
    info = msgspec.structs.replace(table.info, options=options)
    sequences = (split(chunk.batch.select(names)) for chunk in table.chunks(columns=names))
    recordings = map(split, table.recordings().to_batches())
    events, scenes = table.events().to_batches(), table.scenes().to_batches()
    with sole_writer(out):
        return write.write_dataset(out, info, sequences=sequences, events=events, recordings=recordings, scenes=scenes)
