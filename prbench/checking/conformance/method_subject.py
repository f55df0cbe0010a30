"""The method under examination, of any benchmark: loaded, fitted if it learns, asked for the same thing only once."""

from __future__ import annotations

import tempfile
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.answer import STATE_SEED, AnyAnswer
from prbench.checking.conformance.report import Remedy
from prbench.harness.methods.loading import LoadedMethod, MethodSpec
from prbench.harness.methods.motions import Declared

_FIRST = "first-motions.npy"
_FEW = 2  # cases that even a slow method is asked about
_PATIENCE = 12.0  # seconds that a batch should take


class MethodSubject(ABC):
    """A method, and the cases that it is asked about.

    Args:
        spec: How to make the method.
        folder: Where a method that learns may leave what it learnt.
    """

    case: ClassVar[str]
    """What it is asked about, for messages: ``sequence`` or ``window``."""
    answer: ClassVar[str] = "motion"
    """What times and memory are told of."""
    asks: ClassVar[str]
    """Name of the check that asks it under every condition."""
    own_generators: ClassVar[Remedy]
    """How a method draws so that nothing decides but what may."""
    own_row: ClassVar[str]
    """How the rows of a batch are kept apart."""

    def __init__(self, spec: MethodSpec, folder: Path) -> None:
        self.spec = spec
        self.folder = folder
        self.overwritten: set[str] = set()
        """Fields of batches that the method wrote into."""
        self.drew_from: set[str] = set()
        """Global generators whose state it moved."""
        self.asking: Callable[[str], None] = lambda _text: None
        """Called before each call of the method, with a text that describes it."""
        self.starting: Callable[[str], None] = lambda _text: None
        """Called with a text that describes the work before the first call."""
        self._answers: dict[StrEnum, Any] = {}

    @property
    @abstractmethod
    def conditions(self) -> tuple[Any, ...]:
        """The conditions that it declares, the richest first."""

    @property
    @abstractmethod
    def n_cases(self) -> int:
        """Number of cases that it can be asked about."""

    @property
    @abstractmethod
    def limits(self) -> str:
        """Say what it declares besides its conditions."""

    @abstractmethod
    def learns(self, loaded: LoadedMethod) -> bool:
        """Return True for a method that learns from a table."""

    @abstractmethod
    def fitted_spec(self) -> MethodSpec:
        """Return how to make the method fitted to the training cases."""

    @abstractmethod
    def batch(self, rows: Sequence[int], condition: Any, *, sample: int = 0) -> Any:
        """Return the conditions of some cases that the method may know.

        Args:
            rows: Numbers of the cases.
            condition: What the method may know of them.
            sample: Another one comes with other noise.
        """

    @abstractmethod
    def rows_of(self, batch: Any, rows: Sequence[int]) -> Any:
        """Return some rows of a batch, in the order given."""

    @abstractmethod
    def nudged(self, batch: Any, by: np.float32) -> Any | None:
        """Return the batch with all given poses moved by some metres; None where none is given."""

    @abstractmethod
    def ask(self, batch: Any, *, seed: int = 0, state_seed: int = STATE_SEED) -> Any:
        """Call the method once; whatever goes wrong is part of the answer."""

    @property
    def adapter(self) -> Any:
        """The method, ready to be asked.

        Raises:
            PrbenchError: if it cannot be loaded or fitted.
        """
        return self.loaded.adapter

    @cached_property
    def loaded(self) -> LoadedMethod:
        """The method as a run holds it; fitted, if it learns and was given no weights.

        Raises:
            PrbenchError: if it cannot be loaded or fitted.
        """
        loaded = self.spec.load()
        if self.spec.weights is not None or self.spec.table_folder is not None or not self.learns(loaded):
            return loaded
        self.asking("while it learnt from a table")
        self.spec = self.fitted_spec()
        return self.spec.load()

    def load_again(self) -> None:
        """Start a program again that was ended because another was started; a method in this process stays."""
        if self.spec.program is not None:
            vars(self).pop("loaded", None)

    @cached_property
    def declared(self) -> Declared:
        """The declarations of the method about itself."""
        return Declared.by(self.adapter, origin=self.origin, conditions=self.spec.group.conditions)

    @property
    def origin(self) -> str:
        """The name of the method in messages."""
        return f"adapter '{self.spec.name}'"

    @property
    def is_installed(self) -> bool:
        """True if it is an installed adapter, wherever it runs; False for a program that the user named."""
        return self.spec.package is None

    @property
    def is_program(self) -> bool:
        """True if it runs in its own process: neither its objects nor its generators can be seen from here."""
        return self.spec.program is not None

    @property
    def working(self) -> tuple[Any, ...]:
        """The conditions under which the harness accepts its answers."""
        if not self.n_cases:
            return ()
        return tuple(condition for condition in self.conditions if self.standard(condition).motions is not None)

    @property
    def main(self) -> Any:
        """The richest working condition."""
        return self.working[0]

    @cached_property
    def first_answer(self) -> Any:
        """The first call of all, which pays for what loads on first use; kept for other processes to compare with."""
        answer: AnyAnswer = self.ask(self.batch(range(min(2, self.n_cases)), self.conditions[0]))
        kept = self.folder / _FIRST
        if answer.motions is not None and not kept.is_file():
            np.save(kept, answer.motions.joints)
        return answer

    def first_motions(self) -> Float[np.ndarray, "batch *frames joints 3"] | None:
        """Return the answer to the very first batch in the first process, or None if there is none."""
        kept = self.folder / _FIRST
        return np.load(kept) if kept.is_file() else None

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """The cases of a usual batch: all, or a few of the shorter ones if the method is slow."""
        total = self.n_cases
        # The first call also pays for loading; only the second tells how slow the method is.
        second: AnyAnswer = self.ask(self.first_answer.batch)
        number = int(np.clip(_PATIENCE * len(second.batch) / max(second.seconds, 1e-9), min(_FEW, total), total))
        last = total - 1 if number == total else total // 2
        return tuple(int(row) for row in np.unique(np.linspace(0, last, number).round().astype(int)))

    def standard(self, condition: Any) -> Any:
        """Return the answer to the usual batch of a condition."""
        if condition not in self._answers:
            self._answers[condition] = self.ask(self.batch(self.rows, condition))
        return self._answers[condition]


def working_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a folder for what a method learns, gone with the check."""
    return tempfile.TemporaryDirectory(prefix="prbench-check-", ignore_cleanup_errors=True)
