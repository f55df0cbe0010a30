"""From diagnosed motions to the budget: groups, gains, and the parts that explain what is lost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from prbench.protocol.manifests import BenchmarkProtocol
from prbench_benchmarks.prime_and_reach.error_budget.bodies import PHASES
from prbench_benchmarks.prime_and_reach.error_budget.gains import gain
from prbench_benchmarks.prime_and_reach.error_budget.looking import CAUSES as LOOK_CAUSES
from prbench_benchmarks.prime_and_reach.error_budget.motions import BESIDE, FEATURES, METHOD, PEOPLE
from prbench_benchmarks.prime_and_reach.error_budget.reaching import CAUSES as REACH_CAUSES
from prbench_benchmarks.prime_and_reach.error_budget.report import AngleGain, Group, Parts

RATES = {"prime_success": "primed", "reach_success": "reached"}
"""Maps each metric to the column of its outcomes."""
ALL = "all"

_PRIME_GAPS = (2.0, 4.0, 6.0)
"""Seconds, upper ends of the bins but the last: about quarters of the study's gaps, of which few exceed 8."""
_Outcomes = dict[tuple[str, str], list[float]]
"""Maps dataset and id of a sequence to the outcomes of its samples."""
_UNITS = {"bearing": "°", "distance": " m", "height": " m", "prime gap": " s"}


@dataclass(frozen=True)
class Motions:
    """Rows of :func:`~prbench_benchmarks.prime_and_reach.error_budget.motions.diagnosed_motions` as arrays."""

    columns: dict[str, np.ndarray]

    @classmethod
    def of(cls, table: pa.Table) -> Motions:
        """Take all columns."""
        return cls({name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names})

    def __len__(self) -> int:
        return len(self.columns["who"])

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[name]

    def where(self, mask: np.ndarray) -> Motions:
        """The rows of a mask."""
        return Motions({name: values[mask] for name, values in self.columns.items()})

    def of_who(self, who: str) -> Motions:
        """The rows of the method, of people …."""
        return self.where(self["who"] == who)


def groups(motions: Motions, protocol: BenchmarkProtocol) -> list[Group]:
    """Group motions by layout and by where and when the goal is; groups without motions are left out.

    Args:
        motions: Of the method or of people.
        protocol: Has the bins of bearing, distance and height.
    """
    return [_group(by, name, part) for by, name, part in _split(motions, protocol) if len(part)]


def _split(motions: Motions, protocol: BenchmarkProtocol) -> Iterator[tuple[str, str, Motions]]:
    yield ALL, ALL, motions
    for dataset in _layouts(motions)[1:]:
        yield "layout", dataset, motions.where(motions["dataset"] == dataset)
    breakdown = protocol.breakdown
    bins = {
        "bearing": breakdown.bearing,
        "distance": breakdown.distance,
        "height": breakdown.height,
        "prime gap": _PRIME_GAPS,
    }
    for by, ends in bins.items():
        number = np.searchsorted(ends, motions[by], side="right")
        for index in range(len(ends) + 1):
            yield by, _bin_name(by, ends, index), motions.where(number == index)


def _layouts(motions: Motions) -> tuple[str, ...]:
    """Return :data:`ALL` and the layouts; of a single layout only the former, which says the same."""
    names = sorted(set(motions["dataset"]))
    return (ALL, *names) if len(names) > 1 else (ALL,)


def _bin_name(by: str, ends: tuple[float, ...], index: int) -> str:
    unit = _UNITS[by]
    if index == len(ends):
        return f"from {ends[-1]:g}{unit}"
    begin = ends[index - 1] if index else 0.0
    return f"{begin:g} to {ends[index]:g}{unit}"


def _group(by: str, name: str, motions: Motions) -> Group:
    bones = Counter(motions["worst_bone"]).most_common(3)
    return Group(
        by=by,
        name=name,
        sequences=len(set(zip(motions["dataset"], motions["sequence_id"], strict=True))),
        recordings=len(set(zip(motions["dataset"], motions["recording_id"], strict=True))),
        primed=float(motions["primed"].mean()),
        looking=_shares(motions["look_cause"], LOOK_CAUSES),
        miss_deg=_median(motions["look_miss_deg"]),
        miss_up_deg=_median(motions["look_miss_up_deg"]),
        miss_aside_deg=_median(np.abs(motions["look_miss_aside_deg"])),
        look_time=_median(motions["look_best_time"]),
        stays=float(motions["look_stays"].mean()),
        stays_with_elevation=float(motions["look_stays_with_elevation"].mean()),
        stays_with_azimuth=float(motions["look_stays_with_azimuth"].mean()),
        reached=float(motions["reached"].mean()),
        reaching=_shares(motions["reach_cause"], REACH_CAUSES),
        smallest=float(np.median(motions["reach_smallest"])),
        skating=float(motions["skating"].mean()),
        slides=float(motions["slides"].mean()),
        slides_in={phase: _mean(motions[f"slides_{phase}"]) for phase in PHASES},
        bone_change=float(motions["bone_change"].mean()),
        worst_bones={bone: count / len(motions) for bone, count in bones},
    )


def _shares(causes: np.ndarray, known: tuple[str, ...]) -> dict[str, float]:
    return {cause: float((causes == cause).mean()) for cause in known}


def _median(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None


def _mean(values: np.ndarray) -> float | None:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else None


def gains(motions: Motions) -> list[AngleGain]:
    """Return the gains of elevation and azimuth of method, people and the run beside, by layout and over all.

    Over all layouts the line has one slope and an offset for each layout, so that layouts whose goals lie lower do not
    pass for heads that follow their goals.
    """
    found = []
    for who in (METHOD, BESIDE, PEOPLE):
        rows = motions.of_who(who)
        for layout in _layouts(rows):
            for angle in ("elevation", "azimuth"):
                ray, goal = (rows[f"look_{side}_{angle}_deg"] for side in ("ray", "goal"))
                if layout == ALL:
                    ray, goal = _about_layouts(ray, goal, rows["dataset"])
                else:
                    inside = rows["dataset"] == layout
                    ray = ray[inside]
                    goal = goal[inside]
                line = gain(goal, ray)
                if line is not None:
                    found.append(
                        AngleGain(
                            who=who,
                            layout=layout,
                            angle=angle,
                            slope=line.slope,
                            offset_deg=line.offset_deg,
                            correlation=line.correlation,
                            motions=line.motions,
                        )
                    )
    return found


def _about_layouts(ray: np.ndarray, goal: np.ndarray, dataset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Both angles with each layout's means moved to the means over all."""
    known = np.isfinite(ray) & np.isfinite(goal)
    moved_ray = np.full(len(ray), np.nan)
    moved_goal = np.full(len(ray), np.nan)
    for layout in set(dataset):
        inside = known & (dataset == layout)
        if inside.any():
            moved_ray[inside] = ray[inside] - ray[inside].mean() + ray[known].mean()
            moved_goal[inside] = goal[inside] - goal[inside].mean() + goal[known].mean()
    return moved_ray, moved_goal


def parts(motions: Motions, samples: int) -> list[Parts]:
    """Say for each rate and layout where successes are lost (docs/error-budget.md#parts).

    Args:
        motions: Of all.
        samples: Motions a sequence of the method, k.
    """
    found = []
    for metric, column in RATES.items():
        for layout in _layouts(motions):
            rows = motions if layout == ALL else motions.where(motions["dataset"] == layout)
            found.append(_parts(metric, layout, rows, column, samples))
    return found


def _parts(metric: str, layout: str, rows: Motions, column: str, samples: int) -> Parts:
    outcomes = {who: _by_sequence(rows.of_who(who), column) for who in (METHOD, BESIDE, PEOPLE, FEATURES)}
    kinds: Counter[str] = Counter()
    for name, successes in outcomes[METHOD].items():
        kinds[_kind(successes, name, outcomes)] += 1
    count = len(outcomes[METHOD])
    method = outcomes[METHOD].values()
    people = [outcomes[PEOPLE][name][0] for name in outcomes[METHOD]]
    decoded = [outcomes[FEATURES][name][0] for name in outcomes[METHOD]]
    return Parts(
        metric=metric,
        layout=layout,
        sequences=count,
        always=kinds["always"] / count,
        noise=kinds["noise"] / count,
        optimisation=kinds["optimisation"] / count,
        representation=kinds["representation"] / count,
        not_learnt=kinds["not_learnt"] / count,
        nor_people=kinds["nor_people"] / count,
        samples=samples,
        mean=float(np.mean([np.mean(successes) for successes in method])),
        best_of_k=float(np.mean([max(successes) for successes in method])),
        people=float(np.mean(people)),
        through_features=float(np.mean(decoded)),
    )


def _kind(successes: list[float], name: tuple[str, str], outcomes: dict[str, _Outcomes]) -> str:
    """Return which of the six shares a sequence belongs to."""
    if all(successes):
        return "always"
    if any(successes):
        return "noise"
    if any(outcomes[BESIDE].get(name, ())):
        return "optimisation"
    if not outcomes[PEOPLE][name][0]:
        return "nor_people"
    return "not_learnt" if outcomes[FEATURES][name][0] else "representation"


def _by_sequence(rows: Motions, column: str) -> _Outcomes:
    """Map each sequence to the outcomes of its samples, in their order."""
    found: _Outcomes = {}
    order = np.argsort(rows["sample"], kind="stable")
    for row in order:
        found.setdefault((str(rows["dataset"][row]), str(rows["sequence_id"][row])), []).append(
            float(rows[column][row])
        )
    return found


def paired_outcomes(motions: Motions, column: str) -> tuple[np.ndarray, np.ndarray, int]:
    """Outcomes of the method and of the run beside it, for the motions that both have.

    Args:
        motions: Of all.
        column: ``primed`` or ``reached``.

    Returns:
        One entry a motion of each, and the number of sequences. Sample i stands beside sample i: both runs gave it the
        same noise seed where they have the same seed.
    """
    method = _by_sequence(motions.of_who(METHOD), column)
    beside = _by_sequence(motions.of_who(BESIDE), column)
    common = sorted(method.keys() & beside.keys())
    pairs = [pair for name in common for pair in zip(method[name], beside[name], strict=False)]
    one, other = zip(*pairs, strict=True) if pairs else ((), ())
    return np.array(one), np.array(other), len(common)
