"""``carry_on.json``: the seams of a run in which puts carry on from generated picks, and the scores of both halves."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.files.bounded import foreign_input
from prbench.files.storage import write_json
from prbench.harness.run_folder.rates_of_people import CarriedOn
from prbench.harness.run_folder.record import read_record

FILE_NAME = "carry_on.json"


def write_carried_on(folder: Path, found: CarriedOn) -> None:
    """Write ``carry_on.json``."""
    write_json(folder / FILE_NAME, msgspec.to_builtins(found))


@foreign_input()
def read_carried_on(folder: Path) -> CarriedOn:
    """Read ``carry_on.json``.

    Raises:
        RunError: if it is missing or damaged.
    """
    path = folder / FILE_NAME
    return read_record(
        path,
        CarriedOn,
        missing=f"{path}: expected the seams of the run, found no file. Run the method again, which adds it.",
        remedy="Delete it and run the method again.",
    )
