"""Tables that are built, and tables that were damaged or edited afterwards."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from prbench.curation import BuildOptions, CurationOptions, build_from_sources
from prbench.curation.build import build_shard_from_sources, merge_dataset_shards
from prbench.curation.corrections import COLUMNS, Correction, Corrections, read_corrections
from prbench.engine.pool import ProcessPool
from prbench.engine.shards import Shard, require_whole
from prbench.errors import TableError
from prbench.sequences import CorpusTable, SequenceTable
from tests.adapters.training.tables import corpus_table
from tests.curation.sources import SceneSource, short_of_memory, some_sources
from tests.fakes import fake_box, fake_dataset
from tests.laws.cases import SameBytes, bad_files

MIXED = (
    *some_sources(4),
    SceneSource("broken", problem="file"),
    SceneSource("bad", skip_reason="known to be bad"),
    SceneSource("other_split", split="train"),
)
CORRECTED = BuildOptions(
    corrections=Corrections(
        "c.csv",
        "digest",
        (
            Correction("adt/room_0/1/pick/14167034", "move", "-0.4", "seen", "MM", "line 2"),
            Correction("adt/room_1/1/put/17830028", "drop", "", "seen", "MM", "line 3"),
        ),
    )
)
CHOSEN = BuildOptions(CurationOptions(minimum_movement="pelvis_displacement"), recordings="room_*", limit=3)


def _whole(sources: Sequence[SceneSource], **settings) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        build_from_sources(list(sources), folder / "table", **settings)

    return build


def _short_of_memory(**settings) -> Callable[[Path], None]:
    """Build two recordings, for one of which the memory does not suffice at the first try."""

    def build(folder: Path) -> None:
        times = folder.with_name("times")
        build_from_sources(short_of_memory(times, 1), folder / "table", **settings)
        assert not list(times.iterdir())

    return build


def _in_shards(count: int, sources: Sequence[SceneSource], **settings) -> Callable[[Path], None]:
    """Neither the order in which shards are named nor that of recordings on a node's disk matters."""

    def build(folder: Path) -> None:
        shards = [folder.with_name(f"shard-{number}") for number in range(1, count + 1)]
        for number, out in enumerate(shards, start=1):
            build_shard_from_sources(list(sources), out, Shard(number, count), **settings)
        merge_dataset_shards(require_whole(shards[::-1]), folder / "table", replace=False)

    return build


SAME_BYTES = [
    SameBytes(
        "a table",
        {
            "in one process": _whole(MIXED),
            "by two workers, from the last": _whole(MIXED[::-1], engine=ProcessPool(2)),
            "in one shard": _in_shards(1, MIXED),
            "in three shards": _in_shards(3, MIXED),
            "in more shards than recordings": _in_shards(16, MIXED),
        },
        differs={"fewer recordings": _whole(MIXED[2:])},
    ),
    SameBytes(
        "a table by other options",
        {"in one process": _whole(MIXED, options=CHOSEN), "in two shards": _in_shards(2, MIXED, options=CHOSEN)},
        differs={"default options": _whole(some_sources(3))},
    ),
    SameBytes(
        "a corrected table",
        {
            "in one process": _whole(MIXED, options=CORRECTED),
            "by two workers, from the last": _whole(MIXED[::-1], options=CORRECTED, engine=ProcessPool(2)),
            "in three shards": _in_shards(3, MIXED, options=CORRECTED),
        },
        differs={"uncorrected": _whole(MIXED)},
    ),
    SameBytes(
        "a table of two recordings",
        {
            "undisturbed": _whole(some_sources(2)),
            "short of memory once": _short_of_memory(),
            "short of memory once, in a pool": _short_of_memory(engine=ProcessPool(2)),
        },
    ),
    SameBytes(
        "a written dataset",
        {
            "once": lambda folder: fake_dataset(folder / "d", 12, boxes=[fake_box("rec000")]) and None,
            "again": lambda folder: fake_dataset(folder / "d", 12, boxes=[fake_box("rec000")]) and None,
        },
    ),
]


def edit(path: Path, column: str) -> None:
    """Change the first value of a column, a text or a number."""
    rows = pq.read_table(path)
    index = rows.schema.get_field_index(column)
    values = rows[column].to_pylist()
    values[0] = f"{values[0]}x" if isinstance(values[0], str) else values[0] + 1.0
    pq.write_table(
        rows.set_column(index, rows.schema.field(index), pa.array(values, rows.schema.field(index).type)), path
    )


def _edited(name: str, column: str) -> tuple[Callable[[Path], None], tuple[str, ...]]:
    return lambda folder: edit(folder / f"{name}.parquet", column), (f"{name}.parquet: ", "changed after the build")


def _spoilt(name: str) -> tuple[Callable[[Path], None], tuple[str, ...]]:
    def spoil(folder: Path) -> None:
        path = folder / f"{name}.parquet"
        content = path.read_bytes()
        damaged = bytes(byte ^ 0xFF for byte in content[4 : len(content) // 3])  # the footer stays whole
        path.write_bytes(content[:4] + damaged + content[len(content) // 3 :])

    return spoil, (name,)


def _another_version(folder: Path) -> None:
    rows = pq.read_table(folder / "sequences.parquet")
    metadata = {**(rows.schema.metadata or {}), b"prbench_schema_version": b"9"}
    pq.write_table(rows.replace_schema_metadata(metadata), folder / "sequences.parquet")


def _without_a_column(folder: Path) -> None:
    path = folder / "sequences.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["prime_kind"]), path)


def _one_row_more(folder: Path) -> None:
    path = folder / "recordings.parquet"
    rows = pq.read_table(path)
    pq.write_table(pa.concat_tables([rows, rows.slice(0, 1)]), path)


def _without_digests(folder: Path) -> None:
    described = json.loads((folder / "dataset.json").read_text())
    del described["file_digests"]
    (folder / "dataset.json").write_text(json.dumps(described))


def _other_boxes(folder: Path) -> None:
    other = fake_dataset(folder.with_name("other"), 6, boxes=[fake_box("rec003")])
    (folder / "scenes.parquet").write_bytes((other.folder / "scenes.parquet").read_bytes())


def _read_table(folder: Path) -> object:
    table = SequenceTable.open(folder)
    return table.scalars(), table.content, table.events(), table.recordings(), table.scenes()


_GOOD = "adt/room_0/1/pick/14167034"


def _corrections(folder: Path) -> Path:
    (folder / "c.csv").write_text(f"{','.join(COLUMNS)}\n{_GOOD},move,-0.4,seen,MM\n")
    return folder / "c.csv"


def _no_corrections(folder: Path) -> Path:
    (folder / "c.toml").write_text("")
    return folder / "c.toml"


def _as_row(row: str, *told: str) -> tuple[Callable[[Path], object], tuple[str, ...]]:
    """Put a row in the place of the good one."""
    return lambda path: path.write_text(f"{','.join(COLUMNS)}\n{row}\n"), ("c.csv, line 2", *told)


def _as_bytes(content: bytes, *told: str) -> tuple[Callable[[Path], object], tuple[str, ...]]:
    return lambda path: path.write_bytes(content), told


def _added(row: str, *told: str) -> tuple[Callable[[Path], object], tuple[str, ...]]:
    """Put a row below the good one."""
    return lambda path: path.write_text(f"{path.read_text()}{row}\n"), ("c.csv, line 3", *told)


BAD_INPUT = [
    *bad_files(
        "corrections",
        _corrections,
        read_corrections,
        {
            "an unknown change": _as_row(f"{_GOOD},delete,,seen,MM", "change: expected drop, move,", "'delete'"),
            "no id": _as_row(",drop,,seen,MM", "event_id: expected an event_id of events.parquet"),
            "a move that is no number": _as_row(f"{_GOOD},move,soon,seen,MM", "value: expected seconds", "'soon'"),
            "a move with a comma": _as_row(f'{_GOOD},move,"-0,4",seen,MM', "such as -0.40, found '-0,4'"),
            "a move by nothing": _as_row(f"{_GOOD},move,0,seen,MM", "not 0"),
            "a move to another event": _as_row(f"{_GOOD},move,60,seen,MM", "from -10 to 10"),
            "a move to nowhere": _as_row(f"{_GOOD},move,nan,seen,MM", "value: expected seconds"),
            "a third hand": _as_row(f"{_GOOD},hand,both,seen,MM", "value: expected left or right, found 'both'"),
            "a flat goal": _as_row(f"{_GOOD},goal,1 2,seen,MM", "value: expected x y z in metres"),
            "a goal beyond the world": _as_row(f"{_GOOD},goal,1 2 1e9,seen,MM", "value: expected x y z in metres"),
            "a goal of letters": _as_row(f"{_GOOD},goal,1 2 x,seen,MM", "value: expected x y z in metres"),
            "no name": _as_row(f"{_GOOD},rename,,seen,MM", "value: expected the object's new name"),
            "a drop with a value": _as_row(f"{_GOOD},drop,1,seen,MM", "value: expected no value for 'drop'"),
            "no reason": _as_row(f"{_GOOD},drop,,,MM", "reason: expected a reason, found nothing"),
            "no author": _as_row(f"{_GOOD},drop,,seen,", "author: expected who says so, found nothing"),
            "too few cells": _as_row(f"{_GOOD},drop", "expected 5 cells, found 2"),
            "an unquoted comma": _as_row(f"{_GOOD},drop,,no, not this,MM", "expected 5 cells, found 6"),
            "a quote that never ends": _as_row(f'{_GOOD},drop,,"seen,MM', "values with commas between"),
            "a row twice": _added(f"{_GOOD},move,-0.4,seen,MM", "'move' of line 2 for the same event"),
            "a drop of what was moved": _added(f"{_GOOD},drop,,seen,MM", "contradicts the 'move' of line 2"),
            "an accepted move": _added(f"{_GOOD},accept,,seen,MM", "contradicts the 'move' of line 2"),
            "semicolons": _as_bytes(
                ";".join(COLUMNS).encode(), "line 1: expected the columns event_id,", "with commas between the columns"
            ),
            "another column": _as_bytes(f"{','.join(COLUMNS)},when".encode(), "line 1: expected the columns", "when"),
            "a column less": _as_bytes(b"event_id,change,value,reason", "line 1: expected the columns"),
            "UTF-16": _as_bytes("event_id".encode("utf-16"), "line 1: expected text in UTF-8", "'CSV UTF-8'"),
            "Latin-1 in line 2": _as_bytes(b"event_id\nM\xfcller", "line 2: expected text in UTF-8", "0xfc"),
            "nothing": _as_bytes(b"", "line 1: expected the columns", "an empty file"),
        },
    ),
    *bad_files(
        "corrections in TOML",
        _no_corrections,
        read_corrections,
        {
            "an unknown key": _as_bytes(b"[[correction]]\nwhen = 1", "unknown field `when` - at `$.correction[0]`"),
            "no tables": _as_bytes(b"correction = 1", "expected tables [[correction]]", "`int` - at `$.correction`"),
            "other tables": _as_bytes(b"[[corrections]]", "expected tables [[correction]]", "corrections"),
            "no table": _as_bytes(b"correction = [1]", "expected tables [[correction]]", "`int`"),
            "a date": _as_bytes(b"[[correction]]\nvalue = 2026-01-01", "expected tables [[correction]]"),
            "no TOML": _as_bytes(b"[[correction]", "expected tables [[correction]]"),
        },
    ),
    *bad_files(
        "a table",
        lambda folder: fake_dataset(folder / "d", 6, boxes=[fake_box("rec000")]).folder,
        _read_table,
        {
            "an edited number": _edited("sequences", "prime_time"),
            "an edited text": _edited("sequences", "text"),
            "an edited event": _edited("events", "event_time"),
            "an edited recording": _edited("recordings", "duration"),
            "other boxes": (_other_boxes, ("scenes.parquet: expected the file that dataset.json describes",)),
            "no boxes": (lambda folder: (folder / "scenes.parquet").unlink(), ("expected scenes.parquet",)),
            "a row more": (_one_row_more, ("recordings.parquet",)),
            "no digests": (_without_digests, ("events.parquet: expected the file that dataset.json describes",)),
            "another version": (_another_version, ("sequences.parquet: expected schema version 3 to 5, found 9",)),
            "a column less": (_without_a_column, ("expected a column 'prime_kind'",)),
            "damaged sequences": _spoilt("sequences"),
            "damaged events": _spoilt("events"),
            "damaged recordings": _spoilt("recordings"),
        },
        error=TableError,
    ),
    *bad_files(
        "a corpus",
        lambda folder: corpus_table(folder / "c").folder,
        CorpusTable.open,
        {"an edited clip": _edited("clips", "fps"), "an edited recording": _edited("recordings", "duration")},
        error=TableError,
    ),
]
