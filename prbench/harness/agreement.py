"""How a method's successes go with those of recorded people, and with where the goal is.

Source: docs/specification/protocol.md#agreement-and-breakdown. A rate says how often a method succeeds; this says on
which sequences.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import special

from prbench.errors import RunError
from prbench.harness.conditions import is_solid
from prbench.harness.intervals import CONFIDENCE, metric_interval
from prbench.harness.planning import Selection
from prbench.harness.run_folder.agreement import FILE_NAME, BinRate, DatasetAgreement, RateAgreement, SceneOfPeople
from prbench.harness.run_folder.folder import DatasetFolder
from prbench.harness.run_folder.scores import CodedScores
from prbench.harness.scoring import score_recorded
from prbench.metrics import METRICS, MetricInfo
from prbench.protocol.manifests import BenchmarkProtocol

RATES: tuple[MetricInfo, ...] = tuple(info for info in METRICS if info.unit == "rate")
_SCENE_METRICS = ("scene_penetration", "scene_depth")
_SAME_WITHIN = 1e-6  # what other processors may make of the same outcomes
_PERFECT = 1 - 1e-12  # beyond which Fisher's scale has no finite value
_MOST_ROWS_LEFT_IN = 10**7
"""Recordings times sequences above which the jackknife takes sums: leaving out one recording after the other takes time
that grows with the square of the data. No dataset of the study comes near."""
_CONSTANT = 1e-12
"""Product of two variances, as a share of the largest possible, below which a column of outcomes is constant."""
_ONE_OUTCOME = "{} the same outcome in every sequence"


@dataclass(frozen=True)
class _Rows:
    """One rate of every motion; sequences may have several."""

    value: Float[np.ndarray, " rows"]
    sequence: np.ndarray
    """Place of each row's sequence in the selection."""

    def by_sequence(self, count: int) -> Float[np.ndarray, " sequences"]:
        """Mean over the samples of each sequence."""
        sums = np.bincount(self.sequence, weights=self.value, minlength=count)
        return sums / np.bincount(self.sequence, minlength=count)

    def only(self, kept: Bool[np.ndarray, " sequences"]) -> _Rows:
        """The rows of some sequences, whose places are counted anew."""
        inside = kept[self.sequence]
        return _Rows(self.value[inside], (np.cumsum(kept) - 1)[self.sequence[inside]])


def agreement_with_people(
    selection: Selection, scores: CodedScores, *, protocol: BenchmarkProtocol
) -> DatasetAgreement:
    """Make ``agreement.json`` of one dataset.

    Args:
        selection: The scored sequences.
        scores: Rows of ``scores.parquet``, of exactly these sequences.
        protocol: Rules by which the scores were made.
    """
    wanted = [*(info.id for info in RATES if info.id in scores.metrics), *_SCENE_METRICS]
    people, goals = score_recorded(selection, protocol.metrics, wanted)
    # Numbers in the order of the names take the place of the names, which are sorted many times.
    recordings = np.unique(np.array(selection.recording_ids, dtype=object), return_inverse=True)[1]
    # The places of 0, 1, 2 … among themselves, sorted as texts: the order in which values are added up.
    count = len(selection)
    ranks = np.empty(count, dtype=np.int64)
    ranks[sorted(range(count), key=str)] = np.arange(count)
    sequences = ranks
    rates: list[RateAgreement] = []
    breakdown: list[BinRate] = []
    for info, rows in _rates(scores, selection):
        # Where recorded gaze has a gap in the frames that decide, people's outcome is not known.
        known = np.isfinite(people[info.id])
        if not known.any():
            continue
        recorded = people[info.id][known]
        own = rows.only(known)
        # Recorded motion compared with itself always succeeds, with which nothing can go together.
        if not info.compares_with_recorded:
            rates.append(_agreement(info, own.by_sequence(len(recorded)), recorded, recordings[known], protocol))
        breakdown += _broken_down(info, own, recorded, recordings[known], goals[known], sequences, protocol)
    return DatasetAgreement(
        dataset=selection.table.info.dataset,
        rates=tuple(rates),
        breakdown=tuple(breakdown),
        scene=_scene(selection, people),
    )


def _scene(selection: Selection, people: Mapping[str, Float[np.ndarray, " n"]]) -> SceneOfPeople | None:
    if not all(name in people for name in _SCENE_METRICS):
        return None
    rows = selection.table.scenes()
    here = set(selection.recording_ids)
    among = np.array([name in here for name in rows["recording_id"].to_pylist()], dtype=bool)
    penetration, depth = (float(people[name].mean()) for name in _SCENE_METRICS)
    solid = int((is_solid(rows) & among).sum())
    return SceneOfPeople(penetration=penetration, depth=depth, boxes=int(among.sum()), solid=solid)


def require_agreement(files: DatasetFolder, made: DatasetAgreement) -> None:
    """Compare ``agreement.json`` with what follows from scores and table; an older run, which has none, passes.

    Raises:
        RunError: naming the first entry that differs.
    """
    if not files.agreement.is_file():
        return
    stored = DatasetAgreement.read(files.path)
    for name, expected, found in _differences(made, stored):
        raise RunError(
            f"{files.agreement}, {name}: expected {expected}, which follows from {files.scores.name} and the table,"
            f" found {found}. One of them was edited. Delete {FILE_NAME} and run the same command again."
        )


def _differences(made: DatasetAgreement, stored: DatasetAgreement) -> Iterator[tuple[str, object, object]]:
    if made.dataset != stored.dataset:
        yield "dataset", made.dataset, stored.dataset
    if made.scene != stored.scene and not _same_scene(made.scene, stored.scene):
        yield "scene", made.scene, stored.scene
    for part in ("rates", "breakdown"):
        expected = [msgspec.to_builtins(entry) for entry in getattr(made, part)]
        found = [msgspec.to_builtins(entry) for entry in getattr(stored, part)]
        if len(expected) != len(found):
            yield part, f"{len(expected)} entries", f"{len(found)}"
        for number, (one, other) in enumerate(zip(expected, found, strict=False)):
            for key, value in one.items():
                if not _same(value, other[key]):
                    yield f"{part}[{number}].{key}", value, other[key]


def _same_scene(expected: SceneOfPeople | None, found: SceneOfPeople | None) -> bool:
    if expected is None or found is None:
        return False
    values = msgspec.structs.asdict(found)
    return all(_same(value, values[key]) for key, value in msgspec.structs.asdict(expected).items())


def _same(expected: object, found: object) -> bool:
    if isinstance(expected, float) and isinstance(found, float):
        return abs(expected - found) <= _SAME_WITHIN
    return expected == found


def _rates(scores: CodedScores, selection: Selection) -> Iterator[tuple[MetricInfo, _Rows]]:
    """Yield the rates that the scores hold, in printed order."""
    places = np.arange(len(selection))
    if scores.sequence_ids != selection.sequence_ids:
        place_of = {name: row for row, name in enumerate(selection.sequence_ids)}
        places = np.array([place_of[name] for name in scores.sequence_ids], dtype=np.int64)
    for info in RATES:
        rows = scores.rows_of(info.id)
        if rows.size:
            yield info, _Rows(scores.value[rows], places[scores.sequence[rows]])


def _agreement(
    info: MetricInfo,
    method: Float[np.ndarray, " n"],
    people: Float[np.ndarray, " n"],
    recordings: np.ndarray,
    protocol: BenchmarkProtocol,
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
    return RateAgreement(
        metric=info.id,
        title=info.title,
        phi=phi,
        low=interval[0] if interval else None,
        high=interval[1] if interval else None,
        sequences=len(method),
        recordings=len(names),
        people=float(people.mean()),
        remark=remark,
    )


def phi_coefficient(method: Float[np.ndarray, " n"], people: Float[np.ndarray, " n"]) -> float | None:
    """Return the correlation of two columns of outcomes (phi for zeros and ones); None where one is constant."""
    if len(method) < 2 or np.ptp(method) == 0 or np.ptp(people) == 0:
        return None
    return float(np.corrcoef(method, people)[0, 1])


def rarest_pair(method: Float[np.ndarray, " n"], people: Float[np.ndarray, " n"]) -> float:
    """Return the sequences expected in the rarest of the four pairs of outcomes, if the two sides were unrelated."""
    rarer = [min(side.mean(), 1 - side.mean()) for side in (method, people)]
    return float(len(method) * rarer[0] * rarer[1])


def phi_interval(
    method: Float[np.ndarray, " n"], people: Float[np.ndarray, " n"], recordings: np.ndarray
) -> tuple[float, float] | None:
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
    if len(names) * len(recordings) <= _MOST_ROWS_LEFT_IN:
        left_out = [_fisher(phi_coefficient(method[recordings != name], people[recordings != name])) for name in names]
    else:
        left_out = [_fisher(phi) for phi in _phi_without_each(method, people, recordings)]
    replicates = [value for value in left_out if value is not None]
    if whole is None or len(replicates) < len(names):
        return None
    spread = np.asarray(replicates) - np.mean(replicates)
    error = np.sqrt((len(names) - 1) / len(names) * (spread**2).sum())
    half = special.stdtrit(len(names) - 1, (1 + CONFIDENCE) / 2) * error
    return float(np.tanh(whole - half)), float(np.tanh(whole + half))


def _phi_without_each(
    method: Float[np.ndarray, " n"], people: Float[np.ndarray, " n"], recordings: np.ndarray
) -> Iterator[float | None]:
    """Yield :func:`phi_coefficient` without each recording, from sums: in linear time, but for rounding the same."""
    number = np.unique(recordings, return_inverse=True)[1]
    products = (np.ones(len(method)), method, people, method * method, people * people, method * people)
    left = np.stack([values.sum() - np.bincount(number, weights=values) for values in products])
    for n, x, y, xx, yy, xy in left.T:
        variances = (n * xx - x * x) * (n * yy - y * y)
        constant = n < 2 or variances <= _CONSTANT * n**4
        yield None if constant else float((n * xy - x * y) / np.sqrt(variances))


def _fisher(phi: float | None) -> float | None:
    return None if phi is None or abs(phi) > _PERFECT else float(np.arctanh(phi))


def _broken_down(
    info: MetricInfo,
    rows: _Rows,
    people: Float[np.ndarray, " n"],
    recordings: np.ndarray,
    goals: Float[np.ndarray, "n 3"],
    sequences: Int[np.ndarray, " _"],
    protocol: BenchmarkProtocol,
) -> Iterator[BinRate]:
    for by, place in goal_places(goals).items():
        for begin, end, inside in _bins(place, getattr(protocol.breakdown, by)):
            chosen = inside[rows.sequence]
            estimate = None
            if inside.any():
                sequence = rows.sequence[chosen]
                estimate = metric_interval(info, rows.value[chosen], recordings[sequence], sequences[sequence])
            yield BinRate(
                metric=info.id,
                title=info.title,
                by=by,
                begin=begin,
                end=end,
                sequences=int(inside.sum()),
                recordings=len(set(recordings[inside])),
                mean=estimate.mean if estimate else None,
                low=estimate.low if estimate else None,
                high=estimate.high if estimate else None,
                people=float(people[inside].mean()) if estimate else None,
            )


def goal_places(goals: Float[np.ndarray, "n 3"]) -> Mapping[str, Float[np.ndarray, " n"]]:
    """Measure where goals are, seen from the first pose.

    Args:
        goals: Canonical frame (the first pelvis over the origin, facing +Z, floor at 0), metres.

    Returns:
        ``bearing`` in degrees from 0 to 180, ``distance`` over the ground and ``height``, both in metres.
    """
    x, y, z = goals.T.astype(np.float64)
    return {"bearing": np.abs(np.rad2deg(np.arctan2(x, z))), "distance": np.hypot(x, z), "height": y}


def _bins(
    place: Float[np.ndarray, " n"], ends: tuple[float, ...]
) -> Iterator[tuple[float, float | None, Bool[np.ndarray, " n"]]]:
    """Yield lower end, upper end and members of each bin; every goal is in exactly one."""
    number = np.searchsorted(ends, place, side="right")
    for index, (begin, end) in enumerate(zip((0.0, *ends), (*ends, None), strict=True)):
        yield begin, end, number == index
