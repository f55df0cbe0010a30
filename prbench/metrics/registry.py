"""The declaration of a metric about itself, and the search for the metrics of this package.

A file of this package that holds a :class:`MetricFamily` named ``FAMILY`` is part of the benchmark; nothing else needs
to be edited.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import KW_ONLY, dataclass
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from prbench.metrics.batch import ScoringPair, require_equal_lengths
from prbench.protocol.manifests import MetricConstants


@dataclass(frozen=True)
class MetricInfo:
    """One column of a score table: all that tables, intervals and controls need to know of a metric.

    Attributes:
        id: Name in ``scores.parquet``, ``summary.json`` and exports; never printed.
        title: Name in printed tables.
        unit: ``rate``, ``ratio``, or a unit such as ``m``. A rate lies between 0 and 1, is printed in % and gets the
            interval of a share. All others are printed as they are.
        higher_is_better: None where neither direction is a merit.
        main: Stands in leaderboards and other tables of several methods; the others stand in the scores of single runs.
        position: Place in a printed table.
        compares_with_recorded: The value compares the predicted motion with the recorded one. Recorded motion compared
            with itself says nothing, so such a metric is left out where recorded motion is scored against another
            sequence's goal. Every metric has to say this; a forgotten one would print a perfect 0.
        can_be_negative: True if a value may be below 0; otherwise no interval reaches below 0.
        irrelevant_if_motionless: The value says nothing of a body that stands still: tables print a dash and rank
            nobody.
        carries_copy_remark: The remark on motions that are copies of the recorded one stands beside this metric.
        in_study: One of the six columns of the study's Table 2.
        title_in_study: Title in the study's Table 2; empty where it is ``title``.
        ranked: Methods are ranked by this metric, if it is a main one. False for a condition that a motion has to meet,
            which no method meets better than a body that stands still.
        compared: Two methods are compared by this metric, if it is a main one.
        is_detail: Stands in files and reports alone, not in printed tables.
    """

    id: str
    title: str
    unit: str
    _: KW_ONLY
    higher_is_better: bool | None
    main: bool
    position: int
    compares_with_recorded: bool
    can_be_negative: bool = False
    irrelevant_if_motionless: bool = False
    carries_copy_remark: bool = False
    in_study: bool = False
    title_in_study: str = ""
    ranked: bool = True
    compared: bool = True
    is_detail: bool = False

    @property
    def scale(self) -> float:
        """Factor from a stored value to the printed one."""
        return printed_scale(self.unit)

    @property
    def arrow(self) -> str:
        """`` ↑`` or `` ↓``, towards the better values; empty where neither direction is a merit."""
        if self.higher_is_better is None:
            return ""
        return " ↑" if self.higher_is_better else " ↓"


def described(
    main: bool, id: str, title: str, unit: str, position: int, *, higher_is_better: bool | None, **more: Any
) -> MetricInfo:
    """Describe a metric; ``more`` are further fields of :class:`MetricInfo`."""
    told: dict[str, Any] = {"compares_with_recorded": False} | more
    return MetricInfo(id, title, unit, higher_is_better=higher_is_better, main=main, position=position, **told)


headline = partial(described, True)  # of a metric that stands in leaderboards
detail = partial(described, False)  # of one that stands in the scores of single runs alone
compared_detail = partial(detail, compares_with_recorded=True)  # of such a one that looks at the recorded motion, too
# Of an error of the study: a distance from the recorded motion.
study_error = partial(headline, higher_is_better=False, in_study=True, compares_with_recorded=True)


def printed_scale(unit: str) -> float:
    """Return the factor from a stored value to the printed one: 100 for rates, 1 for all other units."""
    return 100.0 if unit == "rate" else 1.0


def printed_unit(unit: str) -> str:
    """Return what stands behind a printed value, after a space: ``%`` for rates, nothing for ratios, else the unit."""
    return {"rate": " %", "ratio": ""}.get(unit, f" {unit}")


def exported_unit(unit: str) -> str:
    """Return the unit of a value in CSV and JSON, where rates are in % too."""
    return "%" if unit == "rate" else unit


@dataclass(frozen=True, eq=False)
class MetricValues:
    """One metric of every sequence.

    Attributes:
        flags: Remarks such as ``no_candidate_frames``, each with the sequences that it holds for.
    """

    metric: str
    value: Float[np.ndarray, " n"]
    flags: Mapping[str, Bool[np.ndarray, " n"]]

    @property
    def flag(self) -> list[str | None]:
        """The remarks of each sequence in one string, joined by ``;``, or None."""
        texts: list[str | None] = [None] * len(self.value)
        for name, raised in self.flags.items():
            for i in np.flatnonzero(raised):
                texts[i] = name if texts[i] is None else f"{texts[i]};{name}"
        return texts


@dataclass(frozen=True, eq=False)
class MetricFamily:
    """A metric and its variants, computed together because they share their work.

    Attributes:
        compute: One result for each of ``metrics``, in that order.
        needs_gaze: Computed only where the predicted motions have gaze: recorded motion, and methods that generate it.
        needs_scene: Computed only where the boxes of the scene are handed in.
    """

    metrics: tuple[MetricInfo, ...]
    compute: Callable[[ScoringPair, MetricConstants], tuple[MetricValues, ...]]
    minimum_frames: int = 2
    needs_gaze: bool = False
    needs_scene: bool = False


def find_families(package: str, path: Iterable[str]) -> tuple[MetricFamily, ...]:
    """Find the ``FAMILY`` of every module of a package.

    Args:
        package: Dotted name of the package.
        path: Folders of its modules.

    Returns:
        The families by the position of their first metric.

    Raises:
        ValueError: if two metrics have the same id.
    """
    modules = [importlib.import_module(f"{package}.{module.name}") for module in pkgutil.iter_modules(path)]
    families = [module.FAMILY for module in modules if hasattr(module, "FAMILY")]
    ids = Counter(info.id for family in families for info in family.metrics)
    repeated = sorted(name for name, count in ids.items() if count > 1)
    if repeated:
        raise ValueError(f"{package}: expected every metric to have an id of its own, found '{repeated[0]}' twice")
    return tuple(sorted(families, key=lambda family: family.metrics[0].position))


CHUNK_FRAMES = 8192
LENGTH_MISMATCH = "length_mismatch"


def score_pair(
    pair: ScoringPair,
    constants: MetricConstants,
    families: tuple[MetricFamily, ...],
    *,
    metrics: Collection[str] | None,
    allow_length_mismatch: bool,
    chunk_frames: int,
) -> dict[str, MetricValues]:
    """Compute the wanted metrics chunk by chunk; see :func:`prbench.metrics.score`."""
    targets = pair.targets
    known = {info.id: family for family in families for info in family.metrics}
    unknown = sorted(set(metrics or ()) - known.keys())
    if unknown:
        raise ValueError(f"unknown metric '{unknown[0]}'; known ones are: {', '.join(known)}")
    wanted = []
    for family in families:
        lacks_gaze = family.needs_gaze and targets.gaze is None
        lacks_scene = family.needs_scene and targets.scene is None
        if metrics is not None and not any(info.id in metrics for info in family.metrics):
            continue
        if metrics is None and (lacks_gaze or lacks_scene):
            continue
        if lacks_gaze:
            raise ValueError("a metric of gaze was asked for, but the targets hold no gaze")
        if lacks_scene:
            raise ValueError("a metric of the scene was asked for, but the targets hold no boxes")
        wanted.append(family)
    _check(pair, max((family.minimum_frames for family in wanted), default=1), allow_length_mismatch)
    chunks = []
    for start, stop in pair.predicted.chunk_bounds(chunk_frames):
        part = pair.part(start, stop)
        part.predicted.require_finite("predicted", counted_from=start)
        part.recorded.require_finite("recorded", counted_from=start)
        chunks.append({values.metric: values for family in wanted for values in family.compute(part, constants)})
    # The whole batch is known here; a chunk would flag only its own sequences.
    mismatch = pair.predicted.n_frames != pair.recorded.n_frames
    infos = [info for family in wanted for info in family.metrics if metrics is None or info.id in metrics]
    found = {}
    for info in sorted(infos, key=lambda info: info.position):
        parts = [chunk[info.id] for chunk in chunks]
        names = parts[0].flags if parts else ()
        flags = {name: np.concatenate([part.flags[name] for part in parts]) for name in names}
        if parts and mismatch.any():
            flags[LENGTH_MISMATCH] = mismatch
        raised = {name: mask for name, mask in flags.items() if mask.any()}
        value = np.concatenate([part.value for part in parts]) if parts else np.empty(0)
        found[info.id] = MetricValues(info.id, value, raised)
    return found


def _check(pair: ScoringPair, minimum: int, allow_length_mismatch: bool) -> None:
    predicted = pair.predicted
    recorded = pair.recorded
    targets = pair.targets
    if not len(targets) == predicted.n_sequences == recorded.n_sequences:
        found = f"found {predicted.n_sequences}, {recorded.n_sequences} and {len(targets)}"
        raise ValueError(f"expected as many predicted as recorded motions and targets, {found}")
    if not allow_length_mismatch:
        require_equal_lengths(predicted, recorded)
    if targets.gaze is not None and len(targets.gaze.valid) != len(predicted.values):
        raise ValueError(f"expected {len(predicted.values)} gaze rays, found {len(targets.gaze.valid)}")
    if targets.scene is not None and len(targets.scene) != len(targets):
        raise ValueError(f"expected the boxes of {len(targets)} sequences, found those of {len(targets.scene)}")
    predicted.require_frames(minimum)
    recorded.require_frames(minimum)
