"""``plan.json``: what a table decided before its first row, so that it goes on the same way after a kill."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.errors import RunError, StorageError
from prbench.storage import write_json
from prbench.workflows.table_two.budget import RowCost

FILE_NAME = "plan.json"
_VERSION = 1


class TablePlan(msgspec.Struct, frozen=True, kw_only=True):
    """The whole file."""

    schema_version: int = _VERSION
    asked: str
    """Digest of the request and its tables."""
    limit: int | None
    """Sequences of each dataset; None until it is known."""
    minutes: int | None
    """The time that the limit follows from; None where the user named the limit."""
    costs: dict[str, RowCost] = {}
    """Measured, by row."""

    def write(self, folder: Path) -> None:
        """Write ``plan.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))


def open_plan(folder: Path, asked: str, *, limit: int | None, minutes: int) -> TablePlan:
    """The plan of a folder, or a new one in a new folder.

    Raises:
        RunError: if the folder belongs to another request, or the file is damaged.
        StorageError: if the folder holds something else.
    """
    path = folder / FILE_NAME
    if not path.is_file():
        if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
            raise StorageError(
                f"{folder}: is not empty and holds no {FILE_NAME}, so it is no folder of a table."
                " Choose an empty or new folder for --out."
            )
        plan = TablePlan(asked=asked, limit=limit, minutes=None if limit is not None else minutes)
        plan.write(folder)
        return plan
    try:
        plan = msgspec.json.decode(path.read_bytes(), type=TablePlan)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise RunError(f"{path}: not a valid {FILE_NAME}: {error}. Choose another folder for --out.") from error
    if plan.schema_version != _VERSION or plan.asked != asked:
        raise RunError(
            f"{path}: expected the plan of this request, found another one's: --data, --split, --limit, --seed,"
            " --samples, --option, --batch-size, --control or the version of prbench differ. Choose another folder for"
            " --out, or delete this one."
        )
    return plan
