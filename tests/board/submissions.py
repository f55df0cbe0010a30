"""Tables of the same sequences, runs on them, submissions of these, and forgeries that hold together on the outside."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from prbench.board.submission import FILE_NAME, RUNS, open_submission, pack
from prbench.contract import Condition
from prbench.files.archives import write_archive
from prbench.files.storage import file_digest
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.sequences import Sequence
from tests.fakes import fake_dataset
from tests.shared import made_once

DATASET = "synthetic-adt"
PREDICTIONS = f"{DATASET}/predictions/part-00000.parquet"


def _make(folder: Path) -> None:
    table = fake_dataset(folder / "table", 32, recordings=16).folder
    for name, method, condition in (
        ("still", "static", Condition.NONE),
        ("scripted", "scripted", Condition.GOAL_LOCATION),
        ("people", "ground-truth", Condition.GOAL_LOCATION),
    ):
        run_method(RunRequest(method=method, condition=condition, data=(table,), out=folder / "runs" / name))


def made() -> Path:
    """A table and three runs on it, made once; ``table`` and ``runs`` below it are never written to."""
    return made_once("submissions", _make)


def submitted(out: Path, *names: str, **about: object) -> Path:
    """A submission of some of the runs."""
    paths = [made() / "runs" / name for name in names or ("still",)]
    pack(paths, out, checker=RunChecker(), **{"name": "Mine", **about})
    return out


def repacked(folder: Path, out: Path) -> Path:
    """Pack an unpacked submission again, its list made anew, as whoever forges one with care does."""
    values = json.loads((folder / FILE_NAME).read_bytes())
    files = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*")) if path.is_file()}
    del files[FILE_NAME]
    values["members"] = {name: file_digest(path) for name, path in files.items()}
    values["runs"] = {path.parent.name: json.loads(path.read_bytes()) for path in folder.glob(f"{RUNS}/*/run.json")}
    first = next(iter(values["runs"].values()))
    values["protocol_digest"] = first["protocol_digest"]
    write_archive(out, {FILE_NAME: json.dumps(values).encode(), **files})
    return out


def forged(folder: Path, forge: Callable[[Path], object], name: str = "still") -> Path:
    """A submission of one run whose unpacked folder was forged and packed again."""
    open_submission(submitted(folder / "honest.zip", name), folder / "unpacked")
    forge(folder / "unpacked" / RUNS / name)
    return repacked(folder / "unpacked", folder / "forged.zip")


def edit_json(path: Path, **values: object) -> None:
    """Change some values of a JSON object."""
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def edit_motions(run: Path, change: Callable[[list[dict]], list[dict]]) -> None:
    """Change the rows of a run's predictions; the metadata stay."""
    rows = pq.read_table(run / PREDICTIONS)
    pq.write_table(pa.Table.from_pylist(change(rows.to_pylist()), schema=rows.schema), run / PREDICTIONS)


def score_again(run: Path) -> None:
    """Score edited motions as prbench does, so that all files of the run follow from one another."""
    for name in ("summary.json", "scores.parquet", "agreement.json"):
        (run / DATASET / name).unlink()
    record = msgspec.json.decode((run / "run.json").read_bytes())
    method = record["method"]["name"]
    request = RunRequest(method=method, condition=Condition(record["condition"]), data=(made() / "table",), out=run)
    run_method(request)


def moved_table(folder: Path, metres: float, sequences: int = 32) -> Path:
    """The table with all bodies and goals elsewhere: other values of the same sequences."""

    def moved(row: Sequence) -> Sequence:
        return replace(row, joints=row.joints + np.float32(metres), goal_location=row.goal_location + metres)

    return fake_dataset(folder, sequences, recordings=16, change=moved).folder
