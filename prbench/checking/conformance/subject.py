"""The method under examination: loaded, fitted if it learns, and asked for the same thing only once."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.answer import STATE_SEED, Answer, ask
from prbench.checking.conformance.cases import Cases, write_training_table
from prbench.contract import Adapter, Condition, ConditionBatch
from prbench.evaluation.conditions import ConditionSource, run_salt
from prbench.evaluation.planning import rows_of
from prbench.manifests import load_protocol
from prbench.methods.declared import Declared
from prbench.methods.loaded_methods import LoadedMethod, MethodSpec
from prbench.methods.methods import fit_to_training_rows, fitted_to
from prbench.methods.motions import native_frames
from prbench.sequences import SequenceTable

RICHEST_FIRST = (Condition.GOAL_LOCATION, Condition.GOAL_POSE, Condition.TEXT, Condition.NONE)
"""The condition that most checks use is the first of these that works."""
_SALT = run_salt(0, "conformance")
_FIRST = "first-motions.npy"
_FEW = 2  # sequences that even a slow method is asked about
_PATIENCE = 12.0  # seconds that a batch should take


class Subject:
    """A method, and the sequences that it is asked about.

    Args:
        spec: How to make the method.
        cases: What it is asked about.
        folder: Where a method that learns may leave what it learnt.
    """

    def __init__(self, spec: MethodSpec, cases: Cases, folder: Path) -> None:
        self.spec = spec
        self.cases = cases
        self.folder = folder
        self.overwritten: set[str] = set()
        """Fields of batches that the method wrote into."""
        self.drew_from: set[str] = set()
        """Global generators whose state it moved."""
        self.asking: Callable[[str], None] = lambda _text: None
        """Called before each call of the method, with a text that describes it."""
        self.starting: Callable[[str], None] = lambda _text: None
        """Called with a text that describes the work before the first call."""
        self._answers: dict[Condition, Answer] = {}

    @property
    def adapter(self) -> Adapter:
        """The method, ready to generate.

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
        if self.spec.weights is not None or self.spec.fit_folder is not None or not loaded.is_trainable:
            return loaded
        table = self.cases.train_folder or write_training_table(self.folder / "table")
        self.asking("while it learnt from a table")
        if self.spec.program is None:
            self.spec = replace(self.spec, fit_folder=self.folder / "fit", table_folder=table, fit=fit_to_training_rows)
        else:
            self.spec = fitted_to(self.spec, SequenceTable.open(table).with_sequences())
        return self.spec.load()

    def load_again(self) -> None:
        """Start a program again that was ended because another was started; a method in this process stays."""
        if self.spec.program is not None:
            self.__dict__.pop("loaded", None)

    @cached_property
    def declared(self) -> Declared:
        """The declarations of the method about itself."""
        return Declared.by(self.adapter, origin=self.origin)

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
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that it declares, the richest first."""
        return tuple(condition for condition in RICHEST_FIRST if condition in self.declared.conditions)

    @property
    def working(self) -> tuple[Condition, ...]:
        """The conditions under which it generated finite motions of the asked lengths."""
        if not len(self.source.n_frames):
            return ()
        return tuple(condition for condition in self.conditions if self.standard(condition).motions is not None)

    @property
    def main(self) -> Condition:
        """The richest working condition."""
        return self.working[0]

    @cached_property
    def source(self) -> ConditionSource:
        """The conditions of the sequences that it can generate in full."""
        source = self.cases.source
        return rows_of(source, [row for row in range(len(source.n_frames)) if self.takes(int(source.n_frames[row]))])

    @property
    def shortest(self) -> int:
        """Frames of the shortest sequence of the protocol: its lead, and an event at prime time."""
        protocol = load_protocol()
        return int(protocol.curation.lead * protocol.fps + 1e-6) + 1

    @property
    def protocols_longest(self) -> int:
        """Frames of its longest sequence: lead and priming window."""
        protocol = load_protocol()
        return int((protocol.curation.priming_window + protocol.curation.lead) * protocol.fps + 1e-6) + 1

    @cached_property
    def longest(self) -> int:
        """Frames of the longest sequence of the protocol that the method takes."""
        n_frames = self.protocols_longest
        while n_frames > 1 and not self.takes(n_frames):
            n_frames -= 1
        return n_frames

    def takes(self, n_frames: int) -> bool:
        """Return True if a sequence of this length at the table's rate stays below ``max_frames``."""
        limit = self.declared.max_frames
        rate = self.declared.native_fps
        if rate is not None:
            n_frames = int(native_frames(np.array([n_frames]), fps=self.cases.source.fps, native_fps=rate)[0])
        return limit is None or n_frames <= limit

    @cached_property
    def first_answer(self) -> Answer:
        """The first call of all, which pays for what loads on first use; kept for other processes to compare with."""
        answer = self.ask(self.batch(range(min(2, len(self.source.n_frames))), self.conditions[0]))
        kept = self.folder / _FIRST
        if answer.motions is not None and not kept.is_file():
            np.save(kept, answer.motions.joints)
        return answer

    def first_motions(self) -> Float[np.ndarray, "batch frames 22 3"] | None:
        """Return the motions of the very first batch in the first process, or None if there are none."""
        kept = self.folder / _FIRST
        return np.load(kept) if kept.is_file() else None

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """The sequences of a usual batch: all, or a few of the shorter ones if the method is slow."""
        total = len(self.source.n_frames)
        # The first call also pays for loading; only the second tells how slow the method is.
        second = self.ask(self.first_answer.batch)
        number = int(np.clip(_PATIENCE * len(second.batch) / max(second.seconds, 1e-9), min(_FEW, total), total))
        last = total - 1 if number == total else total // 2
        return tuple(int(row) for row in np.unique(np.linspace(0, last, number).round().astype(int)))

    def standard(self, condition: Condition) -> Answer:
        """Return the answer to the usual batch of a condition."""
        if condition not in self._answers:
            self._answers[condition] = self.ask(self.batch(self.rows, condition))
        return self._answers[condition]

    def batch(self, rows: Sequence[int], condition: Condition, *, sample: int = 0) -> ConditionBatch:
        """Return the conditions of some sequences that the method may know."""
        return self.source.batch(np.array(rows, dtype=np.int64), condition, seed=0, salt=_SALT, sample=sample)

    def ask(self, batch: ConditionBatch, *, seed: int = 0, state_seed: int = STATE_SEED) -> Answer:
        """Call the method once; whatever goes wrong is part of the answer."""
        of_one = "1 sequence" if len(batch) == 1 else f"{len(batch)} sequences"
        self.asking(
            f"while it generated {of_one} of up to {int(batch.n_frames.max())} frames under {batch.condition.value}"
        )
        answer = ask(self.adapter, batch, seed=seed, state_seed=state_seed, threads=self.spec.threads)
        self.overwritten.update(answer.overwritten)
        self.drew_from.update(answer.drew_from)
        return answer


def working_folder() -> tempfile.TemporaryDirectory[str]:
    """A folder for what a method learns, gone with the check."""
    return tempfile.TemporaryDirectory(prefix="prbench-check-", ignore_cleanup_errors=True)
