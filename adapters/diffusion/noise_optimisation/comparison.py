"""Two modes of noise optimisation on the same sequences: losses, passes, Prime Success, and a verdict."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import NormalDist

import numpy as np
from jaxtyping import Float

from prbench.evaluation.intervals import mean_interval
from prbench.storage import atomic_path
from prbench_adapters.diffusion.noise_optimisation.optimise import OptimisedMotions

_TERMS = ("initial", "goal", "jerk")
MARGIN = 0.10
"""Largest difference in Prime Success that counts as none, as a fraction."""
SEQUENCE_COLUMNS = (
    "sequence_id",
    *_TERMS,
    "prime_success",
    "reach_success",
    "network_passes",
)
CURVE_COLUMNS = ("network_passes", *_TERMS)


@dataclass(frozen=True)
class ModeResult:
    """One mode on n sequences."""

    sequence_ids: tuple[str, ...]
    initial: Float[np.ndarray, " n"]
    goal: Float[np.ndarray, " n"]
    jerk: Float[np.ndarray, " n"]
    prime_success: Float[np.ndarray, " n"]
    reach_success: Float[np.ndarray, " n"]
    network_passes: Float[np.ndarray, " n"]

    def rows(self) -> list[list[object]]:
        """One row a sequence, in the order of :data:`SEQUENCE_COLUMNS`."""
        columns = (getattr(self, name).tolist() for name in SEQUENCE_COLUMNS[1:])
        return [list(row) for row in zip(self.sequence_ids, *columns, strict=True)]

    @classmethod
    def read(cls, path: Path) -> ModeResult:
        """Read what :func:`write_csv` has written of :meth:`rows`."""
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        numbers = {name: np.array([float(row[name]) for row in rows]) for name in SEQUENCE_COLUMNS[1:]}
        return cls(tuple(row["sequence_id"] for row in rows), **numbers)


def curve(found: OptimisedMotions) -> list[list[float]]:
    """Median losses of the iterates after each iteration, with the passes spent by then on a sequence.

    A finished sequence counts with its final losses.
    """
    iterations = len(found.history.learning_rate)
    chains = found.iterations.numpy() + _decoded_again(found)
    # All chains have equally many steps; dividing gives the passes of one iteration.
    each = float((found.network_passes.numpy() / chains).max())
    medians = []
    for name in _TERMS:
        values = getattr(found.history, name)
        final = getattr(found, name).cpu().numpy()
        # NaN in the history means finished, not missing.
        medians.append(np.median(np.where(np.isnan(values), final, values), axis=1))
    return [[each * (i + 1), *(float(column[i]) for column in medians)] for i in range(iterations)]


def _decoded_again(found: OptimisedMotions) -> np.ndarray:
    """1 for sequences that ran to the end and were decoded once more without gradients, 0 for finished ones."""
    return (~np.isnan(found.history.goal[-1])).astype(np.int64)


def write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Write a table of text.

    Raises:
        StorageError: if it cannot be written.
    """
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def read_curve(path: Path) -> Float[np.ndarray, "iterations 4"]:
    """Rows of :func:`curve` as written."""
    return np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def verdict(fast: ModeResult, paper: ModeResult, recording_ids: Sequence[str]) -> dict[str, object]:
    """Compare the fast mode with the paper's: medians of final losses, and the paired interval of Prime Success.

    Args:
        fast: The mode in question.
        paper: The mode that it is held against, on the same sequences.
        recording_ids: One a sequence; sequences of one recording are not independent.
    """
    if fast.sequence_ids != paper.sequence_ids:
        raise ValueError("the two modes were not run on the same sequences")
    medians = {
        name: {"fast": float(np.median(getattr(fast, name))), "paper": float(np.median(getattr(paper, name)))}
        for name in _TERMS
    }
    low, high = prime_difference_interval(fast.prime_success - paper.prime_success, recording_ids)
    shown = low is not None and high is not None and low > -MARGIN and high < MARGIN
    return {
        "sequences": len(fast.sequence_ids),
        "medians": medians,
        "goal_no_higher": medians["goal"]["fast"] <= medians["goal"]["paper"],
        "jerk_no_higher": medians["jerk"]["fast"] <= medians["jerk"]["paper"],
        "prime_success": {"fast": float(fast.prime_success.mean()), "paper": float(paper.prime_success.mean())},
        "reach_success": {"fast": float(fast.reach_success.mean()), "paper": float(paper.reach_success.mean())},
        "prime_difference": float((fast.prime_success - paper.prime_success).mean()),
        "prime_difference_95": [low, high],
        "prime_equal_within_10_points": "shown" if shown else "not shown",
        "network_passes": {"fast": float(fast.network_passes.mean()), "paper": float(paper.network_passes.mean())},
    }


def prime_difference_interval(
    differences: Float[np.ndarray, " n"], recording_ids: Sequence[str]
) -> tuple[float | None, float | None]:
    """95 % interval of the mean paired difference of a rate; None for a bound that the data cannot give.

    The wider of the benchmark's interval over recordings and Agresti and Min's adjusted Wald interval (half a sequence
    added to each cell of the paired table): the first alone would be a point where no sequence differs.
    """
    own = mean_interval(differences, list(recording_ids))
    n = len(differences)
    gained = float((differences > 0).sum())
    lost = float((differences < 0).sum())
    centre = (gained - lost) / (n + 2)
    spread = math.sqrt(gained + lost + 1.0 - (gained - lost) ** 2 / (n + 2)) / (n + 2)
    reach = NormalDist().inv_cdf(0.975) * spread
    if own.low is None or own.high is None:
        # Equal differences of several recordings have no interval of their own, and Agresti and Min's stands alone.
        equal = "all_equal" in own.marks and own.n_recordings > 1
        return (centre - reach, centre + reach) if equal else (None, None)
    return min(own.low, centre - reach), max(own.high, centre + reach)


def draw_curves(path: Path, curves: Mapping[str, Float[np.ndarray, "iterations 4"]]) -> None:
    """Median losses against network passes, one plot a loss, all modes in each.

    Raises:
        StorageError: if the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    units = {"initial": "m²", "goal": "m²", "jerk": "m / frame³"}
    figure = Figure(figsize=(12.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    for place, name in enumerate(_TERMS, start=1):
        axes = figure.add_subplot(1, len(_TERMS), place)
        for mode, rows in curves.items():
            axes.plot(rows[:, 0], rows[:, place], label=mode, linewidth=1)
        axes.set(xscale="log", yscale="log", title=f"median {name} loss", ylabel=units[name])
        axes.set_xlabel("network passes a sequence")
        axes.grid(alpha=0.3)
        axes.legend()
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")
