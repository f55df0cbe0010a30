"""What curation finds in synthetic recordings, against what was acted out (``prbench synthesize``)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from prbench.cli.progress import progress
from prbench.cli.terminal import print_table

if TYPE_CHECKING:
    from prbench.checking.matching import Verification
    from prbench.engine import Engine

_FEWEST_VERIFIED = 4
"""Recordings on which each noise level is verified at least."""


class FoundHands(msgspec.Struct, frozen=True, kw_only=True):
    """Which hand curation names for the events that have a place.

    Attributes:
        right: Number of events with the hand that acted.
        wrong: Number of events with the other hand.
        unknown: Number of events without a hand.
    """

    right: int
    wrong: int
    unknown: int


class SensorCheck(msgspec.Struct, frozen=True, kw_only=True):
    """The events that curation finds with sensors of one kind, against those that were acted out.

    Events within the sensors' resolution of a threshold and lost tracks are not counted. Numbers without a sample are
    null.

    Attributes:
        sensors: ``these files``, or a level of noise.
        recordings: Number of recordings.
        events: Number of true events.
        recall: Share of the true events that were found.
        precision: Share of the found events that are true.
        timing_bias: Mean of found minus true event time, in seconds.
        timing_median: Median size of that difference, in seconds.
        timing_p95: 95th percentile of its size, in seconds.
        priming_recall: Share of the primed events that were found primed.
        unprimed: Number of events without a true prime.
        false_primes: Share of those that were found primed all the same.
        prime_median: Median size of found minus true prime time, in seconds.
        prime_p5: 5th percentile of found minus true prime time, in seconds.
        prime_p95: 95th percentile of found minus true prime time, in seconds.
        hands: Hands of all events that have a place.
        expected_sequences: Number of sequences that were acted out.
        missed_sequences: Number of those that were not found.
    """

    sensors: str
    recordings: int
    events: int
    recall: float | None
    precision: float | None
    timing_bias: float | None
    timing_median: float | None
    timing_p95: float | None
    priming_recall: float | None
    unprimed: int
    false_primes: float | None
    prime_median: float | None
    prime_p5: float | None
    prime_p95: float | None
    hands: FoundHands
    expected_sequences: int
    missed_sequences: int


def compare_with_truth(
    root: Path, *, layout: str, recordings: int, seed: int, engine: Engine
) -> list[tuple[str, Verification]]:
    """Compare curation with the truth, for written files and at each noise level for the same seed.

    Args:
        root: The files.
        layout: Their layout.
        recordings: Number of recordings in them; each noise level gets as many, and four at least.
        seed: Of the people.
        engine: Carries the work out.

    Returns:
        The name of the sensors and what was found with them, the files first.
    """
    from prbench.checking.verify_synthetic import LEVELS, verify_level, verify_tree

    with progress("comparing curation with the truth") as tell:
        checked = [("these files", verify_tree(root, dataset=layout, engine=engine))]
        for done, level in enumerate(LEVELS, start=1):
            tell(done, len(LEVELS), level.name)
            result = verify_level(
                level,
                preset=layout,
                recordings=max(recordings, _FEWEST_VERIFIED),
                seed=seed,
                engine=engine,
            )
            checked.append((level.name, result))
    return checked


def sensor_check(sensors: str, result: Verification) -> SensorCheck:
    """Turn a comparison into the shape that ``--json`` prints."""
    low, _, high = result.prime_quantiles
    return SensorCheck(
        sensors=sensors,
        recordings=result.recordings,
        events=result.true_events,
        recall=result.recall,
        precision=result.precision,
        timing_bias=result.timing.bias,
        timing_median=result.timing.median,
        timing_p95=result.timing.p95,
        priming_recall=result.priming_recall,
        unprimed=result.unprimed,
        false_primes=result.false_primes,
        prime_median=result.prime.median,
        prime_p5=low,
        prime_p95=high,
        hands=FoundHands(right=result.hands.right, wrong=result.hands.wrong, unknown=result.hands.unknown),
        expected_sequences=result.expected_sequences,
        missed_sequences=len(result.missed_sequences),
    )


def print_checks(checked: list[tuple[str, Verification]], missed: tuple[str, ...]) -> None:
    """Print a row for each kind of sensors, and the sequences that were missed in the files."""
    print_table(
        "what curation finds, against what was acted out",
        (
            "sensors", "recordings", "events", "recall", "precision", "timing bias", "median", "p95", "priming recall",
            "false primes", "prime median", "p5 … p95", "hands", "sequences",
        ),
        [_check_row(name, result) for name, result in checked],
        numbers=range(1, 14),
    )  # fmt: skip
    print("times in ms; events within the sensors' resolution of a threshold and lost tracks are not counted")
    print("hands: right / wrong / unknown of all located events; sequences: found of those that were acted out")
    for text in missed:
        print(f"no sequence in these files: {text}")


def _check_row(name: str, result: Verification) -> tuple[str, ...]:
    low, _, high = result.prime_quantiles
    return (
        name,
        str(result.recordings),
        str(result.true_events),
        f"{result.recall:.3f}",
        f"{result.precision:.3f}",
        f"{result.timing.bias * 1e3:+.0f}",
        f"{result.timing.median * 1e3:.0f}",
        f"{result.timing.p95 * 1e3:.0f}",
        f"{result.priming_recall:.3f}",
        f"{result.false_primes:.3f} of {result.unprimed}",
        f"{result.prime.median * 1e3:.0f}",
        f"{low * 1e3:+.0f} … {high * 1e3:+.0f}",
        f"{result.hands.right} / {result.hands.wrong} / {result.hands.unknown}",
        f"{result.expected_sequences - len(result.missed_sequences)} of {result.expected_sequences}",
    )
