"""``agreement.json``: how a method's successes go with recorded people's, and with where the goal is."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.files.bounded import foreign_input
from prbench.files.storage import write_json
from prbench.harness.run_folder.rates_of_people import BinRate, RateAgreement, SceneOfPeople
from prbench.harness.run_folder.record import read_record

FILE_NAME = "agreement.json"


class DatasetAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """All rates of one method on one dataset.

    Attributes:
        dataset: Name of the dataset.
        rates: Agreement with recorded people, one entry a rate.
        breakdown: Rates by the goal's place, by metric, quantity and bin.
        scene: How recorded people keep out of the scene's boxes; None where the table knows of none.
    """

    dataset: str
    rates: tuple[RateAgreement, ...]
    breakdown: tuple[BinRate, ...]
    scene: SceneOfPeople | None = None

    def write(self, folder: Path) -> None:
        """Write ``agreement.json``."""
        write_json(folder / FILE_NAME, msgspec.to_builtins(self))

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> DatasetAgreement:
        """Read ``agreement.json``.

        Raises:
            RunError: if it is missing or damaged.
        """
        path = folder / FILE_NAME
        return read_record(
            path,
            cls,
            missing=f"{path}: expected the agreement with recorded people, found no file. Run the method again, which"
            " adds it, or score the motions again.",
            remedy="Delete it and run the method again.",
        )
