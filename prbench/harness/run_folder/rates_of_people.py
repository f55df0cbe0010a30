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
