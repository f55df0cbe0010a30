"""Figure S3: Prime Success over the distance δ and the window σ, from saved motions, without generating again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Float

from prbench.engine import Engine
from prbench.errors import RunError
from prbench.harness.planning import Selection, select
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import CONTROL
from prbench.harness.run_folder.scores import read_scores
from prbench.metrics import MotionBatch
from prbench.metrics.prime_success import Variant, primed
from prbench.metrics.ray_track import candidate_frames, head_track
from prbench.protocol.manifests import MetricConstants
from prbench_benchmarks.prime_and_reach.study.document import MEASURED, SYNTHETIC, StudyBlock, StudyTable, StudyValue
from prbench_benchmarks.prime_and_reach.study.genuine import GenuineRun
from prbench_benchmarks.prime_and_reach.study.settings import load_study_settings
from prbench_benchmarks.prime_and_reach.study.sizes import SYNTHETIC_NOTE

_COLUMNS = ["goal_location", "prime_time", "start_time", "head_tilt_deg", "fps", "joints"]
_METRIC = {"equation": "prime_success", "onset": "prime_success_onset"}
_PRINTED_DISTANCES = (0.1, 0.25, 0.5, 1.0)  # metres, columns of the printed table; the CSV has all


@dataclass(frozen=True)
class Sweep:
    """Prime Success of one run over both limits."""

    run: GenuineRun
    variant: Variant
    windows: tuple[float, ...]
    """σ, seconds."""
    distances: tuple[float, ...]
    """δ, metres."""
    rates: Float[np.ndarray, "windows distances"]
    """From 0 to 1, mean over sequences (of the mean over samples)."""
    sequences: int


@dataclass(frozen=True)
class _Work:
    """One window of sequences and one sample of it."""

    motion: MotionBatch
    prime_time: np.ndarray
    goal: np.ndarray
    tilt: np.ndarray
    fps: np.ndarray
    constants: MetricConstants
    windows: tuple[float, ...]
    distances: tuple[float, ...]
    variant: Variant


def sweep(run: GenuineRun, *, variant: Variant, engine: Engine) -> Sweep:
    """Compute Prime Success for every pair of limits.

    Args:
        run: Whose scores were held against its motions.
        variant: Reading of the deceleration (docs/specification/metrics.md#prime-success).
        engine: Where the windows of sequences are worked on.

    Raises:
        RunError: if the value at the protocol's own limits is not the stored one.
    """
    settings = load_study_settings().figure_s3
    count = round(settings.largest_distance / settings.distance_step)
    distances = tuple(round(k * settings.distance_step, 6) for k in range(count + 1))
    # The sequences of a run that have motions.
    record = run.run.record
    chosen = select(run.table, split=record.split, limit=record.limit)
    scored = set(read_scores(run.run.dataset(run.record.dataset).scores)["sequence_id"].to_pylist())
    selection = chosen.chosen(np.array([name in scored for name in chosen.sequence_ids]))
    constants = run.protocol.metrics
    sums = np.zeros((len(settings.windows), len(distances)))
    motions = 0
    for successes in engine.map(_swept, list(_work(run, selection, constants, settings.windows, distances, variant))):
        sums += successes.sum(axis=-1)
        motions += successes.shape[-1]
    found = Sweep(run, variant, settings.windows, distances, sums / motions, len(selection))
    _require_protocol_value(found, constants)
    return found


def sweep_table(sweeps: Sequence[Sweep]) -> StudyTable:
    """Make the curves a table; the CSV has every point."""
    blocks = []
    values = []
    for one in sweeps:
        columns = [one.distances.index(distance) for distance in _PRINTED_DISTANCES]
        rows = tuple(
            (f"{window:g} s", *(f"{100 * rates[column]:.2f}" for column in columns))
            for window, rates in zip(one.windows, one.rates, strict=True)
        )
        word = ", measured on synthetic data" if one.run.record.synthetic else ""
        blocks.append(StudyBlock(f"{one.run.title}{word}, {one.sequences} sequences", rows))
        values += [_value(one, i, j) for i in range(len(one.windows)) for j in range(len(one.distances))]
    synthetic = any(one.run.record.synthetic for one in sweeps)
    return StudyTable(
        number="of Figure S3",
        title=f"Prime Success in % ({sweeps[0].variant}) over δ (columns) and σ (rows)",
        header=("σ", *(f"δ = {distance:g} m" for distance in _PRINTED_DISTANCES)),
        blocks=tuple(blocks),
        values=tuple(values),
        notes=(
            "The study prints its curves in a figure only, so that nothing published stands beside.",
            "σ = 0 s: the frame nearest to the prime time alone.",
            "Intervals stand with the protocol's limits on the leaderboard; points of a curve share their sequences.",
            *((SYNTHETIC_NOTE,) if synthetic else ()),
        ),
    )


def _value(one: Sweep, i: int, j: int) -> StudyValue:
    return StudyValue(
        dataset=one.run.record.dataset,
        condition=one.run.run.record.condition,
        method=one.run.run.record.method.name,
        variant=f"sigma {one.windows[i]:g} s; delta {one.distances[j]:g} m",
        metric=_METRIC[one.variant],
        value=float(100 * one.rates[i, j]),
        unit="%",
        sequences=one.sequences,
        origin=SYNTHETIC if one.run.record.synthetic else MEASURED,
    )


def _work(
    run: GenuineRun,
    selection: Selection,
    constants: MetricConstants,
    windows: tuple[float, ...],
    distances: tuple[float, ...],
    variant: Variant,
):
    predictions = Predictions.open(run.run.dataset(run.record.dataset).predictions)
    for _, chunk in selection.windows(_COLUMNS):
        for sample in range(run.run.record.samples):
            rows = predictions.motions(chunk.sequence_ids, sample)
            yield _Work(
                motion=MotionBatch(rows.values, rows.offsets),
                prime_time=chunk.numbers("prime_time") - chunk.numbers("start_time"),
                goal=chunk.vectors("goal_location").astype(np.float64),
                tilt=chunk.numbers("head_tilt_deg"),
                fps=chunk.numbers("fps"),
                constants=constants,
                windows=windows,
                distances=distances,
                variant=variant,
            )


def _swept(work: _Work) -> Float[np.ndarray, "windows distances n"]:
    """Success of each motion for each pair of limits."""
    found = np.zeros((len(work.windows), len(work.distances), work.motion.n_sequences))
    for i, window in enumerate(work.windows):
        constants = msgspec.structs.replace(work.constants, prime_window=window)
        prime_time = work.prime_time
        if window == 0.0:  # no frame lies exactly at the prime time, so the nearest one is meant
            prime_time = np.round(prime_time * work.fps) / work.fps
        candidates = candidate_frames(work.motion.n_frames, prime_time, work.fps, constants)
        track = head_track(work.motion, candidates, work.goal, work.tilt, work.fps, constants)
        for j, distance in enumerate(work.distances):
            limits = msgspec.structs.replace(constants, prime_distance=distance)
            found[i, j] = primed(track, candidates, limits, work.variant)
    return found


def _require_protocol_value(found: Sweep, constants: MetricConstants) -> None:
    """Hold the sweep against the stored scores where both have the same limits."""
    run = found.run
    # Recorded motion is scored against other goals there, which a sweep over its own goals does not repeat.
    if run.run.record.control is not None and run.run.record.method.kind == CONTROL:
        raise RunError(f"{run.run.path}: was made with --control; its sweep would be of other goals than its scores.")
    if constants.prime_window not in found.windows or constants.prime_distance not in found.distances:
        return
    scores = read_scores(run.run.dataset(run.record.dataset).scores).to_pydict()
    wanted = _METRIC[found.variant]
    stored = np.mean([value for metric, value in zip(scores["metric"], scores["value"]) if metric == wanted])
    i = found.windows.index(constants.prime_window)
    j = found.distances.index(constants.prime_distance)
    if abs(stored - found.rates[i, j]) > 1e-9:
        raise RunError(
            f"{run.run.path}: expected a Prime Success of {stored:.6f} at the protocol's limits, as its scores say,"
            f" found {found.rates[i, j]:.6f}. One of its files was edited. Run the method again."
        )
