"""Figure S3: Prime Success over the distance δ and the window σ, from saved motions, without generating again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.datasets import ON_SYNTHETIC_DATA
from prbench.engine import Engine
from prbench.errors import RunError
from prbench.harness.planning import Selection, select
from prbench.harness.run_folder import CONTROL, Predictions, read_scores
from prbench.metrics import MotionBatch
from prbench.metrics.prime_success import primed
from prbench.metrics.ray_track import candidate_frames, head_track
from prbench.protocol.manifests import MetricConstants
from prbench.tables import Block, Cell, Column, Row, Table
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun
from prbench_benchmarks.prime_and_reach.study.sizes import origin_of

_COLUMNS = ["goal_location", "prime_time", "start_time", "head_tilt_deg", "fps", "joints"]
_METRIC = "prime_success"
# How Figure S3 is drawn; nothing here decides a score. From the paper, section E, but for the step, a choice of ours.
WINDOWS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)  # seconds, one curve each
LARGEST_DISTANCE = 1.0  # metres, end of the axis
DISTANCE_STEP = 0.025  # metres: 41 points, among them the protocol's 0.25 m
_PRINTED_DISTANCES = (0.1, 0.25, 0.5, 1.0)  # metres, columns of the printed table; the CSV has all


@dataclass(frozen=True)
class Sweep:
    """Prime Success of one run over both limits.

    Attributes:
        windows: σ, seconds.
        distances: δ, metres.
        rates: Means over sequences (of the mean over samples), from 0 to 1.
    """

    run: GenuineRun
    windows: tuple[float, ...]
    distances: tuple[float, ...]
    rates: Float[np.ndarray, "windows distances"]
    sequences: int


def sweep(run: GenuineRun, *, engine: Engine) -> Sweep:
    """Compute Prime Success for every pair of limits.

    Args:
        run: Run whose scores were held against its motions.
        engine: Engine that works on the windows of sequences.

    Raises:
        RunError: if the value at the protocol's own limits is not the stored one.
    """
    # Recorded motion is scored against other goals there, which a sweep over its own goals does not repeat.
    if run.run.record.control is not None and run.run.record.method.kind == CONTROL:
        raise RunError(f"{run.run.path}: was made with --control; its sweep would be of other goals than its scores.")
    windows = WINDOWS
    distances = tuple(round(k * DISTANCE_STEP, 6) for k in range(round(LARGEST_DISTANCE / DISTANCE_STEP) + 1))
    # The sequences of a run that have motions.
    record = run.run.record
    chosen = select(run.table, split=record.split, limit=record.limit)
    scores = read_scores(run.run.dataset(run.record.dataset).scores)
    scored = set(scores["sequence_id"].to_pylist())
    selection = chosen.chosen(np.array([name in scored for name in chosen.sequence_ids]))
    constants = run.protocol.metrics
    sums = np.zeros((len(windows), len(distances)))
    motions = 0
    swept = partial(_swept, constants=constants, windows=windows, distances=distances)
    for successes in engine.map(swept, list(_motions(run, selection))):
        sums += successes.sum(axis=-1)
        motions += successes.shape[-1]
    rates = sums / motions
    # Where both have the same limits, the sweep has to give the stored scores.
    if constants.prime_window in windows and constants.prime_distance in distances:
        found = rates[windows.index(constants.prime_window), distances.index(constants.prime_distance)]
        stored = scores["value"].to_numpy()[np.array(scores["metric"].to_pylist()) == _METRIC].mean()
        if abs(stored - found) > 1e-9:
            raise RunError(
                f"{run.run.path}: expected a Prime Success of {stored:.6f} at the protocol's limits, as its scores"
                f" say, found {found:.6f}. One of its files was edited. Run the method again."
            )
    return Sweep(run, windows, distances, rates, len(selection))


def _motions(run: GenuineRun, selection: Selection) -> Iterator[tuple[MotionBatch, dict[str, np.ndarray]]]:
    """Yield the motions of each window of sequences and each sample, with what they are judged by."""
    predictions = Predictions.open(run.run.dataset(run.record.dataset).predictions)
    for _, chunk in selection.windows(_COLUMNS):
        judged_by = {
            "prime_time": chunk.numbers("prime_time") - chunk.numbers("start_time"),
            "goal": chunk.vectors("goal_location").astype(np.float64),
            "tilt": chunk.numbers("head_tilt_deg"),
            "fps": chunk.numbers("fps"),
        }
        for sample in range(run.run.record.samples):
            rows = predictions.motions(chunk.sequence_ids, sample)
            yield MotionBatch(rows.values, rows.offsets), judged_by


def _swept(
    work: tuple[MotionBatch, dict[str, np.ndarray]],
    *,
    constants: MetricConstants,
    windows: tuple[float, ...],
    distances: tuple[float, ...],
) -> Float[np.ndarray, "windows distances n"]:
    """Success of each motion for each pair of limits."""
    motion, judged_by = work
    fps = judged_by["fps"]
    found = np.zeros((len(windows), len(distances), motion.n_sequences))
    for i, window in enumerate(windows):
        within = msgspec.structs.replace(constants, prime_window=window)
        prime_time = judged_by["prime_time"]
        if window == 0.0:  # no frame lies exactly at the prime time, so the nearest one is meant
            prime_time = np.round(prime_time * fps) / fps
        candidates = candidate_frames(motion.n_frames, prime_time, fps, within)
        track = head_track(motion, candidates, judged_by["goal"], judged_by["tilt"], fps, within)
        for j, distance in enumerate(distances):
            limits = msgspec.structs.replace(within, prime_distance=distance)
            found[i, j] = primed(track, candidates, limits, "equation")
    return found


def sweep_table(sweeps: Sequence[Sweep]) -> Table:
    """Make the curves a table; the CSV has every point."""
    blocks = []
    for one in sweeps:
        record = one.run.run.record
        about: dict[str, Any] = {"condition": record.condition, "method": record.method.name}
        about |= {"dataset": one.run.record.dataset, "origin": origin_of(synthetic=one.run.record.synthetic)}
        rows = []
        for window, rates in zip(one.windows, one.rates, strict=True):
            words = {"window": f"{window:g} s"}
            cells = []
            for distance, rate in zip(one.distances, rates, strict=True):
                if distance in _PRINTED_DISTANCES:
                    words[f"{distance:g}"] = f"{100 * rate:.2f}"
                variant = f"sigma {window:g} s; delta {distance:g} m"
                value = float(100 * rate)
                cells.append(
                    Cell(metric=_METRIC, variant=variant, value=value, unit="%", sequences=one.sequences, **about)
                )
            rows.append(Row(text=words, cells=tuple(cells)))
        word = ", measured on synthetic data" if one.run.record.synthetic else ""
        blocks.append(Block(title=f"{one.run.title}{word}, {one.sequences} sequences", rows=tuple(rows)))
    columns = [Column(key=f"{distance:g}", title=f"δ = {distance:g} m") for distance in _PRINTED_DISTANCES]
    return Table(
        number="of Figure S3",
        title="Prime Success in % over δ (columns) and σ (rows)",
        columns=(Column(key="window", title="σ", text=True), *columns),
        blocks=tuple(blocks),
        notes=(
            "The study prints its curves in a figure only, so that nothing published stands beside.",
            "σ = 0 s: the frame nearest to the prime time alone.",
            "Intervals stand with the protocol's limits on the leaderboard; points of a curve share their sequences.",
            *([ON_SYNTHETIC_DATA] if any(one.run.record.synthetic for one in sweeps) else []),
        ),
    )
