"""Runs, scores and the files that they are read from."""

from __future__ import annotations

import functools
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.engine import ProcessPool
from prbench.engine.shards import Shard, require_whole
from prbench.errors import (
    AdapterError,
    PrbenchError,
    PredictionsError,
    RunError,
    ShardError,
    StorageError,
    TableError,
    UsageError,
)
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.harness.sharded import merge_run_shards, run_shard
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.sequences import SequenceTable
from tests.benchmarks.motion_prediction.windows import write as write_windows
from tests.fakes import fake_dataset
from tests.laws.cases import BadInput, SameBytes
from tests.method_fixtures import adapter_source, write_package
from tests.shared import made_once


def _table() -> Path:
    """60 sequences, 15 of them in the test split, of three recordings."""
    return made_once("60-sequences", lambda path: fake_dataset(path, 60))


def _other_table() -> Path:
    return made_once("24-sequences-of-gimo", lambda path: fake_dataset(path, 24, dataset="synthetic-gimo"))


def _request(out: Path, **changes: object) -> RunRequest:
    wanted = {"method": "static", "condition": "none", "data": (_table(),), "batch_size": 4, "out": out}
    return RunRequest(**{**wanted, **changes})


@contextmanager
def _made_installed() -> Iterator[None]:
    """Install the method ``made``, which draws noise, and give runs a cache that they share."""
    site = made_once("site", lambda path: write_package(path, "made", adapter_source(), package="prbench_made_once"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PRBENCH_CACHE", f"{os.environ['PRBENCH_TESTS_SHARED']}/cache-of-runs")
        patch.syspath_prepend(str(site))
        yield


def _whole(workers: int = 0, **changes: object) -> Callable[[Path], None]:
    def way(folder: Path) -> None:
        with _made_installed():
            run_method(_request(folder / "run", **changes), engine=ProcessPool(workers) if workers else None)

    return way


def _in_shards(count: int, workers: int = 0, **changes: object) -> Callable[[Path], None]:
    def way(folder: Path) -> None:
        shards = [folder.with_name(f"shard-{number}") for number in range(1, count + 1)]
        with _made_installed():
            for number, out in enumerate(shards, start=1):
                run_shard(
                    _request(out, **changes), Shard(number, count), engine=ProcessPool(workers) if workers else None
                )
            merge_run_shards(require_whole(shards[::-1]), folder / "run")

    return way


def _windows() -> Path:
    return made_once("windows", write_windows)


_MADE = {"method": "made", "samples": 2, "seed": 5}
_PREDICTION = {"method": "constant-velocity", "benchmark": "motion-prediction", "condition": "pose"}


def _in_two_shards(name: str, shards: int = 2, **changes: object) -> SameBytes:
    ways = {"whole": _whole(**changes), f"in {shards} shards": _in_shards(shards, **changes)}
    return SameBytes(f"a run of {name}", ways, unequal=("cost.json",))


def _synthetic_table(workers: int = 0) -> Callable[[Path], None]:
    def way(folder: Path) -> None:
        engine = {"engine": ProcessPool(workers)} if workers else {}
        build_synthetic_table("adt", 2, 5, folder / "table", n_events=4, **engine)

    return way


SAME_BYTES = [
    SameBytes(
        "a run of made",
        {
            "in one process": _whole(**_MADE),
            "by two workers": _whole(workers=2, **_MADE),
            "in one shard": _in_shards(1, **_MADE),
            "in three shards by two workers": _in_shards(3, workers=2, **_MADE),
            "in nine shards": _in_shards(9, **_MADE),
        },
        unequal=("cost.json",),
        differs={"another seed": _whole(**_MADE | {"seed": 6})},
    ),
    _in_two_shards("ground-truth", method="ground-truth"),
    _in_two_shards("nearest-neighbour", method="nearest-neighbour"),
    _in_two_shards("scripted with shuffled goals", method="scripted", control="shuffled-goal"),
    _in_two_shards("scripted for a goal pose", method="scripted", condition="goal-pose", limit=7),
    _in_two_shards("made for a goal", method="made", condition="goal-loc", samples=2),
    _in_two_shards("made on a fold", method="made", fold="1/2"),
    SameBytes(
        "a run on two tables",
        {
            "whole": lambda folder: _whole(data=(_table(), _other_table()), batch_size=2)(folder),
            "in 4 shards": lambda folder: _in_shards(4, data=(_table(), _other_table()), batch_size=2)(folder),
        },
        unequal=("cost.json",),
    ),
    SameBytes(
        "a run of motion prediction, sharded",
        {
            "whole": lambda folder: _whole(data=(_windows(),), **_PREDICTION)(folder),
            "in 3 shards": lambda folder: _in_shards(3, data=(_windows(),), **_PREDICTION)(folder),
        },
        unequal=("cost.json",),
    ),
    SameBytes("a synthetic table", {"in one process": _synthetic_table(), "by two workers": _synthetic_table(2)}),
]


def _run(name: str, error: type[Exception], *told: str, unwritten: tuple[str, ...] = ("out",), **changes: object):
    def act(folder: Path) -> None:
        made = {key: value(folder) if callable(value) else value for key, value in changes.items()}
        run_method(_request(made.pop("out", folder / "out"), **made))

    return BadInput(f"run: {name}", act, told, error, unwritten)


def _changed_table(folder: Path, change: Callable[[pa.Table], pa.Table]) -> tuple[Path]:
    table = fake_dataset(folder / "table", 12)
    (part,) = table.part_paths("sequences")
    pq.write_table(change(pq.read_table(part)), part)
    return (folder / "table",)


def _of_version_99(rows: pa.Table) -> pa.Table:
    return rows.replace_schema_metadata(rows.schema.metadata | {b"prbench_schema_version": b"99"})


def _with_another_prime(rows: pa.Table) -> pa.Table:
    column = rows.schema.get_field_index("prime_time")
    return rows.set_column(column, rows.schema.field(column), rows["event_time"])


def _named_evil(folder: Path) -> tuple[Path, ...]:
    described = fake_dataset(folder / "renamed", 30).folder / "dataset.json"
    described.write_text(json.dumps({**json.loads(described.read_text()), "dataset": "../../evil"}))
    return _table(), described.parent


def _with_file(folder: Path, name: str, text: str = "x") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return folder / "out"


_RUNS = [
    _run("one dataset twice", UsageError, "expected different datasets, found synthetic-adt more than once",
         data=lambda _: (_table(), _table())),
    _run("weights that do not exist", UsageError, "gone.pt: expected a file or folder, found neither",
         method="pr", condition="goal-loc", weights=lambda folder: folder / "gone.pt"),
    _run("a missing table", TableError, "expected a built dataset", data=lambda folder: (folder / "gone",)),
    _run("an empty table", TableError, "empty: holds no sequences",
         data=lambda folder: (fake_dataset(folder / "empty", 0).folder,)),
    _run("a file for a table", TableError, "expected a built dataset (a folder with dataset.json), found a file",
         data=lambda folder: (_with_file(folder, "table.parquet").with_name("table.parquet"),)),
    _run("a table of an unknown version", TableError, "expected schema version 3 to 5, found 99",
         data=lambda folder: _changed_table(folder, _of_version_99)),
    _run("a table changed after the build", TableError, "sequences.parquet: ", "not the ones that dataset",
         data=lambda folder: _changed_table(folder, _with_another_prime)),
    _run("a dataset's name that leads out", TableError, "a name that a folder can have, found '../../evil'",
         data=_named_evil, unwritten=("out", "evil")),
    _run("a folder with other things in it", StorageError, "is not empty and holds no run.json",
         out=lambda folder: _with_file(folder, "out/thesis.tex"), unwritten=("out/run.json",)),
    _run("a file in the place of the folder", StorageError, "out: is a file",
         out=lambda folder: _with_file(folder, "out"), unwritten=()),
    _run("a damaged run.json", RunError, "not a valid run.json",
         out=lambda folder: _with_file(folder, "out/run.json", "{"), unwritten=("out/synthetic-adt",)),
    _run("another condition", AdapterError, "'static' does not take the condition 'text'. Choose one of: none",
         condition="text"),
]  # fmt: skip


@functools.cache
def _recorded() -> dict[str, np.ndarray]:
    """Map the test sequences of the table to their motions."""
    motions = {}
    for chunk in SequenceTable.open(_table()).chunks(split="test"):
        motions |= dict(zip(chunk.sequence_ids, np.split(chunk.joints, chunk.offsets[1:-1]), strict=True))
    return motions


def _handed_in(name: str, make: Callable[[Path], Path | None], *told: str, error: type[Exception] = PredictionsError):
    def act(folder: Path) -> None:
        path = make(folder) or folder / "p.parquet"
        score_predictions(ScoreRequest(predictions=path, data=(_table(),)))

    return BadInput(f"score: {name}", act, told, error)


def _columns(**columns: list) -> Callable[[Path], None]:
    return lambda folder: pq.write_table(pa.table(columns), folder / "p.parquet")


def _motions(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Callable[[Path], None]:
    """Write the recorded motions, changed, as nested lists."""

    def make(folder: Path) -> None:
        motions = change(dict(_recorded()))
        _columns(sequence_id=list(motions), joints=[each.reshape(len(each), -1).tolist() for each in motions.values()])(
            folder
        )

    return make


def _npz(change: Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        motions = change(dict(_recorded()))
        lengths = np.array([len(motion) for motion in motions.values()])
        joints = np.concatenate(list(motions.values()))
        np.savez(folder / "p.npz", sequence_id=np.array(list(motions)), n_frames=lengths, joints=joints)
        return folder / "p.npz"

    return make


def _seventh(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict], dict]:
    """Change the motion of the seventh sequence."""
    return lambda motions: motions | {list(motions)[6]: change(motions[list(motions)[6]].astype(np.float64))}


def _infinite(motion: np.ndarray) -> np.ndarray:
    motion = motion.copy()
    motion[17, 3, 1] = np.inf
    return motion


def _flat_and_odd(folder: Path) -> None:
    joints = [motion.ravel().tolist() for motion in _recorded().values()]
    joints[4].pop()
    _columns(sequence_id=list(_recorded()), joints=joints)(folder)


def _looping_link(folder: Path) -> Path:
    (folder / "p.parquet").symlink_to("p.parquet")
    return folder / "p.parquet"


_POSE = [[[0.0] * 66]]
_FIFTEEN = "and 14 other motions of 15"
_HANDED_IN = [
    _handed_in("no ids", _columns(id=["a"]), "expected a column 'sequence_id' or 'opaque_id', found id"),
    _handed_in("no joints", _columns(sequence_id=["a"]), "expected a column 'joints', found sequence_id"),
    _handed_in("numbers for ids", _columns(sequence_id=[1], joints=_POSE), "'sequence_id': expected text, found int64"),
    _handed_in("joints that are no list", _columns(sequence_id=["a"], joints=[0.0]), "'joints': expected a list of fr"),
    _handed_in("text for joints", _columns(sequence_id=["a"], joints=[[["x"] * 66]]), "'joints': expected numbers"),
    _handed_in("half samples", _columns(sequence_id=["a"], sample=[0.5], joints=_POSE), "'sample': expected whole"),
    _handed_in("an empty id", _columns(sequence_id=["a", None], joints=_POSE * 2), "every row of sequence_id"),
    _handed_in("21 joints", _motions(lambda all_: {name: each[:, :21] for name, each in all_.items()}),
               "column 'joints', row 0, frame 0: expected a list of frames, ", "found 63 numbers"),
    _handed_in("an odd number of numbers", _flat_and_odd, "'joints', row 4: expected ", "all frames after one another"),
    _handed_in("no file", lambda folder: folder / "gone.parquet", "gone.parquet: expected a predictions file"),
    _handed_in("text", lambda folder: _with_file(folder, "p.parquet") and None, "p.parquet: expected a readable Parq"),
    _handed_in("an empty folder", lambda folder: folder, ": expected predictions (*.parquet), found none"),
    _handed_in("a link to itself", _looping_link, "p.parquet", error=PrbenchError),
    _handed_in("infinity", _motions(_seventh(_infinite)), "p.parquet, ", ", frame 17: expected finite"),
    _handed_in("NaN", _motions(_seventh(lambda motion: motion * np.nan)), ", frame 0: expected finite"),
    _handed_in("infinity in .npz", _npz(_seventh(_infinite)), "p.npz, row 6, ", ", frame 17: expected finite"),
    _handed_in("more than float32 holds", _npz(_seventh(lambda motion: motion + 1e300)), "row 6, ", ", frame 0: exp"),
    *(
        _handed_in(f"{wrong} in {form.__name__}", form(lambda all_, cut=cut: {name: cut(all_[name]) for name in all_}),
                   said, ": expected ", _FIFTEEN)
        for form in (_motions, _npz)
        for wrong, cut, said in [
            ("a frame too few", lambda motion: motion[:-1], "one frame too few"),
            ("a frame too many", lambda motion: np.concatenate([motion[:1], motion]), "one frame too many"),
            ("another rate", lambda motion: motion[np.arange(0, len(motion) - 1 + 1e-9, 20 / 30).astype(int)],
             "motions at 30 frames per second"),
        ]
    ),
]  # fmt: skip


def _finished(folder: Path) -> Path:
    with _made_installed():
        run_method(_request(folder / "run", **_MADE | {"samples": 1}))
    return folder / "run"


def _run_again(changes: dict[str, object]) -> Callable[[Path], object]:
    def again(path: Path) -> None:
        with _made_installed():
            run_method(_request(path, **_MADE | {"samples": 1} | changes))

    return again


def _another_run(changes: dict[str, object], told: str) -> BadInput:
    """A run into the folder of another one."""
    key = next(iter(changes))

    def act(folder: Path) -> None:
        _run_again(changes)(_finished(folder))

    return BadInput(f"a run's folder: another {key}", act, ("run.json, ", told), RunError)


def _another_shard(changes: dict[str, object], told: str) -> BadInput:
    """Two shards of different runs that are merged."""
    key = next(iter(changes))

    def act(folder: Path) -> None:
        with _made_installed():
            for number, more in ((1, {}), (2, changes)):
                run_shard(_request(folder / f"shard-{number}", **_MADE | {"samples": 1} | more), Shard(number, 2))
            merge_run_shards(require_whole([folder / "shard-1", folder / "shard-2"]), folder / "merged")

    return BadInput(f"a run's shards: another {key}", act, ("shard-2/shard.json, ", told), ShardError, ("merged",))


_OTHERS = [
    _another_run({"seed": 1}, "seed: expected 1 for this run, found 5"),
    _another_run({"batch_size": 3}, "tables.synthetic-adt.batch_plan.batch_size: expected 3 for this run, found 4"),
    _another_run({"limit": 5}, "limit: expected 5 for this run, found nothing"),
    _another_run({"control": "shuffled-goal"}, "control: expected shuffled-goal"),
    _another_run({"method": "static"}, "method.name: expected static for this run, found made"),
    _another_run({"threads": 2}, "threads: expected 2"),
    _another_shard({"seed": 1}, "seed: expected 5, found 1, unlike "),
    _another_shard({"method": "static"}, "method.name: expected made, found static"),
    _another_shard({"batch_size": 5}, "tables.synthetic-adt.batch_plan.batch_size: expected 4, found 5"),
]
_SYNTHETIC = [
    BadInput("a synthetic table without sensors", lambda folder: build_synthetic_table("kitchen", 1, 0, folder / "t"),
             ("kitchen",), UsageError),
    BadInput("a synthetic table without recordings", lambda folder: build_synthetic_table("adt", 0, 0, folder / "t"),
             ("at least one",), UsageError),
]  # fmt: skip
BAD_INPUT = [*_RUNS, *_HANDED_IN, *_OTHERS, *_SYNTHETIC]
