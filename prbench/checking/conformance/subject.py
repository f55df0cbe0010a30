"""A method of prime-and-reach under examination."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from prbench.checking.conformance.answer import STATE_SEED, Answer, ask
from prbench.checking.conformance.cases import Cases, write_training_table
from prbench.checking.conformance.method_subject import MethodSubject
from prbench.checking.conformance.report import Remedy
from prbench.contract import Condition, ConditionBatch
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, fit_to_training_rows, fitted_to
from prbench.harness.methods.motions import native_frames
from prbench.harness.planning import rows_of
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable

RICHEST_FIRST = (Condition.GOAL_LOCATION, Condition.GOAL_POSE, Condition.TEXT, Condition.NONE)
"""The condition that most checks use is the first of these that works."""
_SALT = run_salt(0, "conformance")
OWN_GENERATORS = Remedy(
    "Draw from one generator a sequence, made of its noise_seed alone:"
    " prbench.randomness.sequence_generator(noise_seed), or torch.Generator().manual_seed(noise_seed).",
    "Draw from one generator a sequence, made of the noise_seed of its row alone (numpy.random.default_rng(noise_seed),"
    " SplitMix64 …).",
)


class Subject(MethodSubject):
    """A method of prime-and-reach, and the sequences that it is asked about.

    Args:
        spec: How to make the method.
        cases: What it is asked about.
        folder: Where a method that learns may leave what it learnt.
    """

    case = "sequence"
    asks = "generates"
    own_generators = OWN_GENERATORS
    own_row = (
        "Every row is complete in itself: draw its noise from its own noise_seed, mask padding in attention, losses and"
        " averages, and let no statistic (batch normalisation, the longest row, a common stopping rule) run over rows."
    )

    def __init__(self, spec: MethodSpec, cases: Cases, folder: Path) -> None:
        super().__init__(spec, folder)
        self.cases = cases

    def learns(self, loaded: LoadedMethod) -> bool:
        """See :meth:`MethodSubject.learns`."""
        return loaded.is_trainable

    def fitted_spec(self) -> MethodSpec:
        """Fit it to the training split of the table, or to synthetic people."""
        table = self.cases.train_folder or write_training_table(self.folder / "table")
        if self.spec.program is not None:
            return fitted_to(self.spec, SequenceTable.open(table).with_sequences())
        return replace(self.spec, fit_folder=self.folder / "fit", table_folder=table, fit=fit_to_training_rows)

    @property
    def n_cases(self) -> int:
        """See :attr:`MethodSubject.n_cases`."""
        return len(self.source.n_frames)

    @property
    def limits(self) -> str:
        """Longest motion and rate."""
        declared = self.declared
        limit = "any length" if declared.max_frames is None else f"up to {declared.max_frames} frames"
        rate = "the table's rate" if declared.native_fps is None else f"{declared.native_fps:g} frames a second"
        return f"{limit}; {rate}"

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """The conditions that it declares, the richest first."""
        return tuple(condition for condition in RICHEST_FIRST if condition in self.declared.conditions)

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

    def rows_of(self, batch: ConditionBatch, rows: Sequence[int]) -> ConditionBatch:
        """See :meth:`MethodSubject.rows_of`."""
        return rows_of(batch, rows)

    def nudged(self, batch: ConditionBatch, by: np.float32) -> ConditionBatch | None:
        """Move the initial poses."""
        return None if batch.initial_joints is None else replace(batch, initial_joints=batch.initial_joints + by)

    def batch(self, rows: Sequence[int], condition: Condition, *, sample: int = 0) -> ConditionBatch:
        """See :meth:`MethodSubject.batch`."""
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
