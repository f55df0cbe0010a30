"""How synthetic people act and what their bodies keep (``prbench synthesize --people``)."""

from __future__ import annotations

import msgspec

from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

_RECORDINGS_OF_PEOPLE = 20


class PeopleCheck(msgspec.Struct, frozen=True, kw_only=True):
    """One number of synthetic people beside the range in which it must lie.

    Attributes:
        preset: The people: a dataset whose people they imitate.
        number: Its name, as on the page of synthetic recordings.
        acted: Of noise-free motion and gaze, null without a sample; of body numbers the worst sequence.
        recorded: Of sequences that curation makes of the sensors' recordings, the worst; null for behaviour.
        low: Smallest value allowed; null without one.
        high: Largest value allowed; null without one.
        holds: True if both lie in the range.
        source: Why the range is there: measured on people, our own limit, or the protocol's.
    """

    preset: str
    number: str
    acted: float | None
    recorded: float | None
    low: float | None
    high: float | None
    holds: bool
    source: str


def check_people(layout: str | None, *, seed: int, count: int | None, workers: int) -> list[PeopleCheck]:
    """Measure the people of the preset that was named, or of all presets.

    Args:
        layout: The preset; None for all.
        seed: Of the people.
        count: Number of recordings of each preset; None for the default of twenty.
        workers: Number of processes.
    """
    import math

    from prbench.checking.synthetic_people import people_numbers
    from prbench.engine import engine_for
    from prbench.synthetic.people import PRESETS

    presets = tuple(PRESETS) if layout is None else (layout,)
    checked: list[PeopleCheck] = []
    with progress("acting out people") as tell:
        for done, preset in enumerate(presets):
            tell(done, len(presets), preset)
            numbers = people_numbers(
                preset, recordings=count or _RECORDINGS_OF_PEOPLE, seed=seed, engine=engine_for(workers)
            )
            checked += [
                PeopleCheck(
                    preset=preset,
                    number=each.name,
                    acted=None if math.isnan(each.acted) else each.acted,
                    recorded=each.recorded,
                    low=each.range.low if math.isfinite(each.range.low) else None,
                    high=each.range.high if math.isfinite(each.range.high) else None,
                    holds=each.holds,
                    source=each.range.source,
                )
                for each in numbers
            ]
    return checked


def print_people(checked: list[PeopleCheck]) -> None:
    """Print each number beside its range."""
    print_table(
        "how synthetic people act and move",
        ("preset", "number", "acted out", "recorded", "range", "", "why"),
        [_people_row(each) for each in checked],
        numbers=(2, 3),
    )
    print(
        "of bodies the worst sequence; metres, seconds, degrees (docs/specification/synthetic-recordings.md#behaviour)"
    )


def _people_row(each: PeopleCheck) -> tuple[str, ...]:
    low = "" if each.low is None else f"{each.low:.4g}"
    high = "" if each.high is None else f"{each.high:.4g}"
    return (
        each.preset,
        each.number,
        "" if each.acted is None else f"{each.acted:.3g}",
        "" if each.recorded is None else f"{each.recorded:.3g}",
        f"{low} … {high}",
        "" if each.holds else "OUTSIDE",
        each.source,
    )
