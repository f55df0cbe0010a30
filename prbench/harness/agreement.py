"""How a method's successes go with those of recorded people, and with where the goal is.

Source: docs/specification/protocol.md#agreement-and-breakdown. A rate says how often a method succeeds; this says on
which sequences.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Float
from scipy import special

from prbench.errors import RunError
from prbench.harness import conditions, results, run_folder, scoring
from prbench.harness.intervals import CONFIDENCE, metric_interval
from prbench.harness.planning import Selection
from prbench.harness.run_folder.summary import AGREEMENT_FILE, BinRate, DatasetAgreement, RateAgreement, SceneOfPeople
from prbench.metrics import METRICS, MetricInfo
from prbench.protocol.manifests import BenchmarkProtocol

Numbers = Float[np.ndarray, " n"]

RATES: tuple[MetricInfo, ...] = tuple(info for info in METRICS if info.unit == "rate")
# One outcome a sequence: 0 or 1, or the share of its samples that succeed.
Outcomes = Numbers
# By the id of a rate, for each table: outcomes of the method, those of people, and the recordings.
Sides = dict[str, list[tuple[Outcomes, Outcomes, np.ndarray]]]
_SCENE_METRICS = ("scene_penetration", "scene_depth")
_PERFECT = 1 - 1e-12  # beyond which Fisher's scale has no finite value
_ONE_OUTCOME = "{} the same outcome in every sequence"


def agreement_with_people(
    selection: Selection, scores: run_folder.CodedScores, *, protocol: BenchmarkProtocol, sides: Sides | None = None
) -> DatasetAgreement:
    """Make ``agreement.json`` of one dataset.

    Args:
        selection: The scored sequences.
        scores: Rows of ``scores.parquet``, of exactly these sequences.
        protocol: Rules by which the scores were made.
        sides: The outcomes behind each rate are added here, to be put together with those of other tables.
    """
    wanted = [*(info.id for info in RATES if info.id in scores.metrics), *_SCENE_METRICS]
    people, goals = scoring.score_recorded(selection, protocol.metrics, wanted)
    # Numbers in the order of the names take the place of the names, which are sorted many times.
    recordings = np.unique(np.array(selection.recording_ids, dtype=object), return_inverse=True)[1]
    count = len(selection)
    place_of = {name: row for row, name in enumerate(selection.sequence_ids)}
    places = np.array([place_of[name] for name in scores.sequence_ids], dtype=np.int64)
    rates: list[RateAgreement] = []
    breakdown: list[BinRate] = []
    for info in RATES:
        rows = scores.rows_of(info.id)
        if not rows.size:
            continue
        # Where recorded gaze has a gap in the frames that decide, people's outcome is not known.
        known = np.isfinite(people[info.id])
        rows = rows[known[places[scores.sequence[rows]]]]
        if not rows.size:
            continue
        value = scores.value[rows]
        sequence = places[scores.sequence[rows]]
        # The order of these texts is the order in which values are added up.
        texts = (np.cumsum(known) - 1)[sequence].astype(str)
        # Recorded motion compared with itself always succeeds, with which nothing can go together.
        if not info.compares_with_recorded:
            sums = np.bincount(sequence, weights=value, minlength=count)
            mean = sums[known] / np.bincount(sequence, minlength=count)[known]
            rates.append(_agreement(info, mean, people[info.id][known], recordings[known], protocol))
            if sides is not None:
                part = mean, people[info.id][known], np.array(selection.recording_ids, dtype=object)[known]
                sides.setdefault(info.id, []).append(part)
        for by, place in goal_places(goals).items():
            ends = getattr(protocol.breakdown, by)
            number = np.searchsorted(ends, place, side="right")
            for index, (begin, end) in enumerate(zip((0.0, *ends), (*ends, None), strict=True)):
                inside = known & (number == index)
                chosen = inside[sequence]
                estimate = None
                if inside.any():
                    estimate = metric_interval(info, value[chosen], recordings[sequence[chosen]], texts[chosen])
                bounds: dict[str, Any] = {name: getattr(estimate, name, None) for name in ("mean", "low", "high")}
                bounds["people"] = float(people[info.id][inside].mean()) if estimate else None
                counts = {"sequences": int(inside.sum()), "recordings": len(set(recordings[inside]))}
                about = {"metric": info.id, "title": info.title, "by": by, "begin": begin, "end": end}
                breakdown.append(BinRate(**about, **counts, **bounds))
    scene = None
    if all(name in people for name in _SCENE_METRICS):
        boxes = selection.table.scenes()
        among = np.isin(np.array(boxes["recording_id"].to_pylist()), selection.recording_ids)
        penetration, depth = (float(people[name].mean()) for name in _SCENE_METRICS)
        solid = int((conditions.is_solid(boxes) & among).sum())
        scene = SceneOfPeople(penetration=penetration, depth=depth, boxes=int(among.sum()), solid=solid)
    return DatasetAgreement(
        dataset=selection.table.info.dataset, rates=tuple(rates), breakdown=tuple(breakdown), scene=scene
    )


def pooled_agreement(sides: Sides, protocol: BenchmarkProtocol) -> list[RateAgreement]:
    """Return the agreement of each rate over the sequences of all tables together."""
    whole = {name: [np.concatenate(part) for part in zip(*parts, strict=True)] for name, parts in sides.items()}
    return [_agreement(info, *whole[info.id], protocol=protocol) for info in RATES if info.id in whole]


def require_agreement(files: run_folder.DatasetFolder, made: DatasetAgreement) -> None:
    """Compare ``agreement.json`` with what follows from scores and table; an older run, which has none, passes.

    Raises:
        RunError: naming the first entry that differs.
    """
    if not files.agreement.is_file():
        return
    stored = DatasetAgreement.read(files.path)
    for name, expected, found in results.differences(msgspec.to_builtins(made), msgspec.to_builtins(stored)):
        problem = f"expected {expected}, which follows from {files.scores.name} and the table, found {found}."
        remedy = f"One of them was edited. Delete {AGREEMENT_FILE} and run the same command again."
        raise RunError(f"{files.agreement}, {name}: {problem} {remedy}")


def _agreement(
    info: MetricInfo, method: Outcomes, people: Outcomes, recordings: np.ndarray, protocol: BenchmarkProtocol
) -> RateAgreement:
    names = np.unique(recordings)
    phi = phi_coefficient(method, people)
    interval = None
    if phi is None:
        remark = _ONE_OUTCOME.format("recorded people have" if np.ptp(people) == 0 else "the method has")
    elif len(names) < protocol.breakdown.fewest_recordings:
        remark = f"no interval from fewer than {protocol.breakdown.fewest_recordings} recordings"
    elif rarest_pair(method, people) < protocol.breakdown.fewest_expected:
        remark = "no interval: too few sequences with the rarer outcomes"
    else:
        interval = phi_interval(method, people, recordings)
        remark = "" if interval else "no interval: it rests on a single recording, or all outcomes agree"
    low, high = interval or (None, None)
    counts = {"sequences": len(method), "recordings": len(names), "people": float(people.mean())}
    return RateAgreement(metric=info.id, title=info.title, phi=phi, low=low, high=high, **counts, remark=remark)


def phi_coefficient(method: Numbers, people: Numbers) -> float | None:
    """Return the correlation of two columns of outcomes (phi for zeros and ones); None where one is constant."""
    if len(method) < 2 or np.ptp(method) == 0 or np.ptp(people) == 0:
        return None
    return float(np.corrcoef(method, people)[0, 1])


def rarest_pair(method: Numbers, people: Numbers) -> float:
    """Return the sequences expected in the rarest of the four pairs of outcomes, if the two sides were unrelated."""
    rarer = [min(side.mean(), 1 - side.mean()) for side in (method, people)]
    return float(len(method) * rarer[0] * rarer[1])


def phi_interval(method: Numbers, people: Numbers, recordings: np.ndarray) -> tuple[float, float] | None:
    """Student's 95 % interval of phi from the jackknife over recordings, on Fisher's scale.

    Args:
        method: Share of successes of each sequence.
        people: Success of recorded people, 0 or 1.
        recordings: Recording of each sequence.

    Returns:
        Lower and upper bound; None where a replicate has no finite value on that scale.
    """
    names = np.unique(recordings)
    whole = _fisher(phi_coefficient(method, people))
    left_out = [_fisher(phi_coefficient(method[recordings != name], people[recordings != name])) for name in names]
    replicates = [value for value in left_out if value is not None]
    if whole is None or len(replicates) < len(names):
        return None
    spread = np.asarray(replicates) - np.mean(replicates)
    error = np.sqrt((len(names) - 1) / len(names) * (spread**2).sum())
    half = special.stdtrit(len(names) - 1, (1 + CONFIDENCE) / 2) * error
    return float(np.tanh(whole - half)), float(np.tanh(whole + half))


def _fisher(phi: float | None) -> float | None:
    return None if phi is None or abs(phi) > _PERFECT else float(np.arctanh(phi))


def goal_places(goals: Float[np.ndarray, "n 3"]) -> Mapping[str, Numbers]:
    """Measure where goals are, seen from the first pose.

    Args:
        goals: Canonical frame (the first pelvis over the origin, facing +Z, floor at 0), metres.

    Returns:
        ``bearing`` in degrees from 0 to 180, ``distance`` over the ground and ``height``, both in metres.
    """
    x, y, z = goals.T.astype(np.float64)
    return {"bearing": np.abs(np.rad2deg(np.arctan2(x, z))), "distance": np.hypot(x, z), "height": y}
