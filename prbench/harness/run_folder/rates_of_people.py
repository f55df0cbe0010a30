"""Shapes of rates beside those of recorded people, which files and reports share; they import no arrays."""

from __future__ import annotations

import msgspec


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


class CarriedOn(msgspec.Struct, frozen=True, kw_only=True):
    """Seams and halves of one dataset.

    Attributes:
        dataset: Name of the dataset.
        pairs: Number of pairs of a pick and the put that follows it.
        share_of_picks: Share of the picks of the split that have such a put.
        median_gap: Median of the seconds from the pick's event to the put's first recorded frame; below 0 in overlaps.
        overlapping: Share of the pairs whose recorded sequences overlap.
        largest_step: Largest way of a joint from the last frame of a pick to the first of its put, metres.
        speed_change: Change of a joint's velocity across the seam, mean over joints and pairs, m/s.
        recorded_speed_change: The same of recorded people, from one frame to the next at the pick's event; null where
            no frame after it was recorded.
        picks: Mean of each metric over the picks, by id.
        puts: Mean of each metric over the puts, by id.
    """

    dataset: str
    pairs: int
    share_of_picks: float
    median_gap: float
    overlapping: float
    largest_step: float
    speed_change: float
    recorded_speed_change: float | None
    picks: dict[str, float]
    puts: dict[str, float]
