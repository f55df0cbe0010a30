"""What intervals and comparisons are worth, as Markdown: ``python -m benchmarks.statistics [data sets a cell]``.

Run it from the repository's root. Ends with status 1 if a cell breaks a promise of
docs/specification/protocol.md#simulation by more than two standard errors of the simulation.
"""

from __future__ import annotations

import sys

import numpy as np
from jaxtyping import Float, Int
from scipy import special, stats

from prbench.harness import clusters
from prbench.harness.clusters import SIGNIFICANCE, PerSet, flip_bounds, flip_test

Sizes = Int[np.ndarray, " units"]
Totals = Float[np.ndarray, "sets units"]
UNITS = (6, 9, 11, 22, 47)
COMPARISONS = 7
LEAST_COVERAGE = 0.93
# What a recording adds to each of its differences, from its place in the distribution (0 to 1); the mean is 0. Every
# sequence adds a normal number of standard deviation 1.
EFFECTS = {
    "binary": lambda place: special.betaincinv(4.5, 4.5, place) - 0.5,  # a difficulty that both methods share
    "independent": lambda place: 0 * place,
    "correlated": special.ndtri,
    "alike": lambda place: 3 * special.ndtri(place),
    "heavy tails": lambda place: special.stdtrit(3, place),
    "one outlier": lambda place: special.ndtri(place) * np.where(np.arange(place.shape[1]) == 0, 10, 1),
    "skewed": lambda place: special.gammaincinv(2, place) - 2,
    "very skewed": lambda place: -2 * np.log1p(-place) - 2,
    "rare": lambda place: 10 * (place > 0.9) - 1.0,
}
# Kinds whose mean is carried by recordings that few data sets hold, so that no test of means is right.
MUST_FAIL = ("very skewed", "rare")
# Distributions of one method's mean of 1 over a recording, from its place.
MEANS = {
    "gamma": lambda place: special.gammaincinv(2, place) / 2,
    "exponential": lambda place: -np.log1p(-place),
    "lognormal": lambda place: np.exp(special.ndtri(place) - 0.5),
}


def designs(units: int) -> tuple[Sizes, Sizes]:
    """Return equal and uneven sizes of units, of five sequences in the mean; uneven ones have from 1 to 12."""
    return np.full(units, 5), (1 + 12 * (np.arange(units) / units) ** 2).astype(int)


def draw(
    kind: str, sizes: Sizes, sets: int, seed: int, *, shift: Float[np.ndarray, " sets"] | float = 0.0, seen: float = 1.0
) -> tuple[Totals, Float[np.ndarray, " sets"]]:
    """Draw differences; return totals of units and the variance between sequences.

    Args:
        kind: One of :data:`EFFECTS`.
        sizes: Sequences of each unit.
        sets: Number of data sets.
        seed: Seed of the simulation.
        shift: True mean difference, one for all or one a set.
        seen: Share of the distribution of recordings that is drawn from; the rest is its upper tail.
    """
    rng = np.random.default_rng(seed)
    effect = np.repeat(EFFECTS[kind](rng.uniform(0, seen, (sets, len(sizes)))), sizes, axis=1)
    shift = np.broadcast_to(shift, sets)[:, None]
    values = shift + effect + rng.normal(size=effect.shape)
    if kind == "binary":
        hard = 0.5 + (1 - shift) * effect
        first = rng.random(effect.shape) < hard + shift / 2
        values = first * 1.0 - (rng.random(effect.shape) < hard - shift / 2)
    return np.add.reduceat(values, np.cumsum(sizes) - sizes, axis=1), values.var(axis=1, ddof=1)


def flipped(totals: Totals, sizes: Sizes) -> Float[np.ndarray, "sets flips"]:
    """Return what the flip test is made of, by at most 4,096 flips."""
    return clusters.flipped_means(totals, sizes, clusters.flips(tuple(map(str, range(len(sizes)))), 2**12))


def p_values(totals: Totals, sizes: Sizes) -> dict[str, PerSet]:
    """Return the p-values of the flip test and of those that it is compared with."""
    means = (totals / sizes).round(9)
    one = np.ones(len(sizes), dtype=int)
    error = np.maximum(clusters.standard_error(means, one), 1e-9)
    studentised = totals.sum(axis=1) / sizes.sum() / np.maximum(clusters.standard_error(totals, sizes), 1e-9)
    # Wilcoxon's and the sign test are flip tests of signed ranks and of signs.
    ranks = stats.rankdata(np.abs(means), axis=1) * np.sign(means)
    return {
        "flips": flip_test(flipped(totals, sizes)),
        "t": 2 * special.stdtr(len(sizes) - 1, -np.abs(means.mean(axis=1)) / error),
        "CR2": 2 * special.stdtr(clusters.degrees_of_freedom(sizes), -np.abs(studentised)),
        "sign": flip_test(flipped(np.sign(means), one)),
        "Wilcoxon": flip_test(flipped(ranks, one)),
    }


def measure(kind: str, sizes: Sizes, sets: int) -> tuple[float, float, str]:
    """Measure the flip test on one cell.

    Returns:
        Coverage of intervals, at the difference that a t test finds in about four of five data sets; share of families
        of seven comparisons without any difference that have a finding; and the power at 5 %, with that of the most
        powerful test among those whose level is at most 6 % here.
    """
    null, _ = draw(kind, sizes, sets, 1)
    reach = special.stdtrit(len(sizes) - 1, 0.975) + 0.85
    shift = min(reach * float(null.sum(axis=1).std()) / sizes.sum(), 0.9 if kind == "binary" else np.inf)
    totals, _ = draw(kind, sizes, sets, 2, shift=shift)
    low, high = flip_bounds(flipped(totals, sizes))
    levels = p_values(null, sizes)
    powers = {name: float((p <= SIGNIFICANCE).mean()) for name, p in p_values(totals, sizes).items()}
    holding = [name for name, p in levels.items() if (p <= SIGNIFICANCE).mean() <= SIGNIFICANCE + 0.01]
    best = max(holding, key=lambda name: powers[name], default="flips")
    # Holm rejects a hypothesis if and only if the smallest p-value is below a seventh of the level.
    first_step = float((levels["flips"] <= SIGNIFICANCE / COMPARISONS).mean())
    beside = "" if best == "flips" else f" ({best} {100 * powers[best]:.0f})"
    covered = float(((low <= shift + 1e-9) & (shift - 1e-9 <= high)).mean())
    return covered, 1 - (1 - first_step) ** COMPARISONS, f"{100 * powers['flips']:.0f}{beside}"


def most_covered(kind: str, sizes: Sizes, sets: int) -> float:
    """Return a bound of the coverage of every test that holds 5 %, and is as powerful as this one, without the tail.

    With probability (1 - tail)^units no recording of the upper tail is seen. What is seen is then as if there were no
    tail, and such a test excludes the true mean as often as it finds the difference that the tail makes.
    """
    least_missed = 0.0
    for tail in (0.05, 0.1, 0.15, 0.2):
        totals, _ = draw(kind, sizes, sets, 3, seen=1 - tail)
        mean = totals.sum() / sizes.sum() / sets
        low, high = flip_bounds(flipped(totals, sizes))
        if ((low > mean) | (high < mean)).mean() <= SIGNIFICANCE + 0.01:
            least_missed = max(least_missed, (1 - tail) ** len(sizes) * float((high < 0).mean()))
    return 1 - least_missed


def detected(kind: str, sizes: Sizes, sets: int) -> float | None:
    """Return how often the smallest detectable difference of one data set is found in another; None without one."""
    if len(sizes) < clusters.units_needed(COMPARISONS):
        return None
    about = {"comparisons": COMPARISONS, "rate": kind == "binary"}
    printed = [
        clusters.detectable_difference(row, sizes, each, **about) for row, each in zip(*draw(kind, sizes, sets, 4))
    ]
    if kind == "binary" and max(printed) > 1:
        return None
    totals, _ = draw(kind, sizes, sets, 5, shift=np.array(printed))
    return float((flip_test(flipped(totals, sizes)) <= SIGNIFICANCE / COMPARISONS).mean())


def print_row(name: str, texts: list[str]) -> None:
    """Print one row of a Markdown table."""
    print(f"| {' | '.join([name, *texts])} |", flush=True)


def main(sets: int = 2_000) -> int:
    """Print the tables; a cell has two numbers, of equal and of uneven sizes.

    Args:
        sets: Simulated data sets of each cell.
    """
    failed = []
    print_row("differences", [f"{units} units" for units in UNITS])
    print_row("---", ["---"] * len(UNITS))
    error = 2 * float(np.sqrt(0.06 / sets))
    family_error = 2 * COMPARISONS * float(np.sqrt(SIGNIFICANCE / COMPARISONS / sets))
    for kind in EFFECTS:
        columns: dict[str, list[str]] = {"coverage": [], "families": [], "power": [], "detected": []}
        for units in UNITS:
            for sizes in designs(units):
                covered, family, power = measure(kind, sizes, sets)
                if kind not in MUST_FAIL and covered < LEAST_COVERAGE - error:
                    failed.append(f"{kind}, {units} units: {100 * covered:.1f} % covered")
                # Flips of skewed differences are not exchangeable.
                if kind not in ("skewed", *MUST_FAIL) and family > SIGNIFICANCE + family_error:
                    failed.append(f"{kind}, {units} units: {100 * family:.1f} % of families")
                most = f" (≤ {100 * most_covered(kind, sizes, sets):.0f})" if kind in MUST_FAIL else ""
                share = detected(kind, sizes, sets // 4)
                columns["coverage"].append(f"{100 * covered:.1f}{most}")
                columns["families"].append(f"{100 * family:.1f}")
                columns["power"].append(power)
                columns["detected"].append("–" if share is None else f"{100 * share:.0f}")
        for name, texts in columns.items():
            print_row(f"{kind}: {name}", [", ".join(texts[i : i + 2]) for i in range(0, len(texts), 2)])
    for kind, of_place in MEANS.items():
        shares = []
        for units in UNITS:
            values = of_place(np.random.default_rng(6).uniform(size=(sets, units)))
            ones = np.ones(units, dtype=int)
            low, high = clusters.mean_bounds(values, ones, values.var(axis=1, ddof=1), nonnegative=True)
            shares.append(f"{100 * ((low <= 1) & (high >= 1)).mean():.1f}")
        print_row(f"means, {kind}: coverage", shares)
    print("\n" + "\n".join(f"FAILED: {line}" for line in failed or ["nothing"]))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:2])))
