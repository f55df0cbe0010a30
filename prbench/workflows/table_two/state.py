"""``plan.json``: what a table decided before its first row, so that it goes on the same way after a kill."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import msgspec

from prbench.boundary import foreign_input
from prbench.bounded import read_whole
from prbench.errors import RunError, StorageError
from prbench.storage import remove_leftovers, write_json
from prbench.workflows.table_two.budget import RowCost

FILE_NAME = "plan.json"
_VERSION = 1


class TablePlan(msgspec.Struct, frozen=True, kw_only=True):
    """The whole file."""

    schema_version: int = _VERSION
    asked: dict[str, str]
    """What decides the rows, by what a user calls it, the tables among it."""
    limit: int | None
    """Sequences of each dataset; None until it is known."""
    minutes: int | None
    """The time that the limit follows from; None where the user named the limit."""
    expected_seconds: float | None = None
    """What all of it was expected to take when the limit was found, timing included."""
    costs: dict[str, RowCost] = {}
    """Measured, by kind of row."""

    @property
    def fits(self) -> bool:
        """Whether the limit follows from a time, which is enough for at least one sequence."""
        return self.minutes is not None and (self.expected_seconds or 0.0) <= 60 * self.minutes

    def write(self, folder: Path) -> None:
        """Write ``plan.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))


@foreign_input()
def open_plan(folder: Path, asked: Mapping[str, str], *, limit: int | None, minutes: int) -> TablePlan:
    """The plan of a folder, or a new one in a new folder.

    Raises:
        RunError: if the folder belongs to another request, or the file is damaged.
        StorageError: if the folder holds something else.
    """
    path = folder / FILE_NAME
    if folder.is_file():
        raise StorageError(f"{folder}: is a file. Choose an empty or new folder for --out.")
    remove_leftovers(path)
    if not path.is_file():
        if folder.is_dir() and any(folder.iterdir()):
            raise StorageError(
                f"{folder}: is not empty and holds no {FILE_NAME}, so it is no folder of a table."
                " Choose an empty or new folder for --out."
            )
        plan = TablePlan(asked=dict(asked), limit=limit, minutes=None if limit is not None else minutes)
        plan.write(folder)
        return plan
    try:
        plan = msgspec.json.decode(read_whole(path), type=TablePlan)
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise RunError(f"{path}: not a valid {FILE_NAME}: {error}. Choose another folder for --out.") from error
    if plan.schema_version != _VERSION:
        raise RunError(f"{path}: expected version {_VERSION}, found {plan.schema_version}. Choose another --out.")
    if plan.asked != asked:
        raise RunError(
            f"{path}: the folder holds another table: {_differences(plan.asked, asked)}. Choose another folder for"
            " --out, or delete this one."
        )
    return plan


def _differences(found: Mapping[str, str], wanted: Mapping[str, str]) -> str:
    return "; ".join(
        _difference(key, found.get(key), wanted.get(key))
        for key in dict.fromkeys([*wanted, *found])
        if found.get(key) != wanted.get(key)
    )


def _difference(key: str, found: str | None, wanted: str | None) -> str:
    if not key.startswith("table "):
        return f"{key} was {found or 'not given'}, now is {wanted or 'not given'}"
    if found is None or wanted is None:
        return f"{key} is new" if found is None else f"{key} is missing"
    return f"{key} has other contents now"
