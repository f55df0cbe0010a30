"""``agreement.json``: rates beside those of recorded people, and by the goal's place."""

from __future__ import annotations

from pathlib import Path

import msgspec

from prbench.files.bounded import foreign_input
from prbench.files.storage import write_json
from prbench.harness.run_folder.record import read_record


class RateAgreement(msgspec.Struct, frozen=True, kw_only=True):
    """One rate: the method's success beside that of recorded people on the same sequences.

    Attributes:
        metric: Id of the metric.
        title: Its name as printed.
        phi: Phi coefficient, from -1 to 1; null where one side has a single outcome.
        low: Lower bound of its 95 % interval; null where the data allow none.
        high: Upper bound of the interval.
        sequences: Number of sequences.
        recordings: Number of recordings that they come from.
        people: Share of the sequences on which recorded people succeed.
        remark: Why there is no coefficient or no interval; empty if there are both.
    """

    metric: str
    title: str
    phi: float | None
    low: float | None
    high: float | None
    sequences: int
    recordings: int
    people: float
    remark: str


class BinRate(msgspec.Struct, frozen=True, kw_only=True):
    """One rate on the sequences whose goal lies in one bin.

    Attributes:
        metric: Id of the metric.
        title: Its name as printed.
        by: ``bearing`` (degrees), ``distance`` or ``height`` (metres).
        begin: Lower end of the bin, included.
        end: Upper end, excluded; null for the last bin.
        sequences: Number of sequences in it.
        recordings: Number of recordings that they come from.
        mean: The method's rate; null without sequences.
        low: Lower bound of its 95 % interval; null where the data allow none.
        high: Upper bound of the interval.
        people: The rate of recorded people on the same sequences; null without sequences.
    """

    metric: str
    title: str
    by: str
    begin: float
    end: float | None
    sequences: int
    recordings: int
    mean: float | None
    low: float | None
    high: float | None
    people: float | None


class SceneOfPeople(msgspec.Struct, frozen=True, kw_only=True):
    """How the recorded people of some sequences keep out of the boxes around them (docs/specification/scene.md).

    Attributes:
        penetration: Share of frames with a joint deeper than the limit in a box, mean over sequences.
        depth: Largest depth of a joint in a box, mean over sequences, metres.
        boxes: Number of boxes that stand in the recordings.
        solid: Number of them that are obstacles.
    """

    penetration: float
    depth: float
    boxes: int
    solid: int


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
            missing=f"{path}: expected the agreement with recorded people, found no file. Score the motions again.",
            remedy="Delete it and run the method again.",
        )
