"""What a metric says about itself, and how the metrics of this package are found.

A file of this package that holds a :class:`MetricFamily` named ``FAMILY`` is part of the benchmark; nothing else needs
to be edited.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from prbench.manifests import MetricConstants
from prbench.metrics.targets import ScoringPair


@dataclass(frozen=True)
class MetricInfo:
    """One column of a score table."""

    id: str
    title: str
    """As printed."""
    unit: Literal["rate", "m", "ratio"]
    """A rate is 0 or 1 a sequence and printed as a percentage; metres and ratios are printed as they are."""
    higher_is_better: bool | None
    """None where neither direction is a merit."""
    main: bool
    """One of the six of the study; the others stand beside them."""
    position: int
    """Place in a printed table."""


@dataclass(frozen=True, eq=False)
class MetricValues:
    """One metric of every sequence."""

    metric: str
    value: Float[np.ndarray, " n"]
    flags: Mapping[str, Bool[np.ndarray, " n"]]
    """Remarks such as ``no_candidate_frames``, each with the sequences that it holds for."""

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
    """A metric and its variants, computed together because they share their work."""

    metrics: tuple[MetricInfo, ...]
    compute: Callable[[ScoringPair, MetricConstants], tuple[MetricValues, ...]]
    """One result for each of ``metrics``, in that order."""
    minimum_frames: int = 2
    needs_gaze: bool = False
    """Computed only where recorded gaze is handed in."""


def find_families(package: str, path: Iterable[str]) -> tuple[MetricFamily, ...]:
    """The ``FAMILY`` of every module of a package, by the position of their first metric."""
    modules = [importlib.import_module(f"{package}.{module.name}") for module in pkgutil.iter_modules(path)]
    families = [module.FAMILY for module in modules if hasattr(module, "FAMILY")]
    return tuple(sorted(families, key=lambda family: family.metrics[0].position))
