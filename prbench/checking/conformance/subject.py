"""The method under examination: loaded, fitted if it learns, asked for the same thing once, and what it answered."""

from __future__ import annotations

import dataclasses
import math
import random
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from prbench.checking.conformance.cases import Cases
from prbench.checking.conformance.findings import Remedy
from prbench.contract import Adapter, Condition, ConditionBatch, Motions
from prbench.errors import PrbenchError
from prbench.files.arrays import load_array
from prbench.harness.conditions import ConditionSource, run_salt
from prbench.harness.methods.loading import LoadedMethod, MethodSpec, fit_to_training_rows, fitted_to
from prbench.harness.methods.motions import Declared, generate_checked, native_frames
from prbench.harness.methods.process import computing_threads
from prbench.harness.planning import rows_of
from prbench.protocol.manifests import load_protocol
from prbench.sequences import SequenceTable


def generators_touched(before: dict[str, bytes]) -> tuple[str, ...]:
    """Return the names of the generators whose state differs from ``before``."""
    return tuple(name for name, state in generator_states().items() if before.get(name, state) != state)


def generator_states() -> dict[str, bytes]:
    """Map the name of each global generator to its state."""
    # The key changes every 624 draws only; the place in it changes with each.
    _, key, *place = np.random.get_state(legacy=True)  # noqa: NPY002 - only looked at
    found = {
        "random": repr(random.getstate()).encode(),
        "numpy.random": np.asarray(key).tobytes() + repr(place).encode(),
    }
    torch = sys.modules.get("torch")
    if torch is not None and hasattr(torch, "random"):
        found["torch"] = torch.random.get_rng_state().numpy().tobytes()
    return found


@contextmanager
def generators_set_to(seed: int) -> Iterator[None]:
    """Seed all global generators, and restore their states at the end."""
    python = random.getstate()
    legacy = np.random.get_state()  # noqa: NPY002 - put back as it was
    torch = sys.modules.get("torch")
    drawn = torch.random.get_rng_state() if torch is not None and hasattr(torch, "random") else None
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - a method that draws from it is found out by another seed
    if torch is not None and drawn is not None:
        torch.random.manual_seed(seed)
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(legacy)  # noqa: NPY002 - put back as it was
        if torch is not None and drawn is not None:
            torch.random.set_rng_state(drawn)


# Seed of the global generators before every call. Only the check of global generators uses another one.
STATE_SEED = 20_240_607
# Metres by which a motion may change where only rounding differs (docs/specification/protocol.md#reproducibility)
TOLERANCE = 1e-4


@dataclass(frozen=True)
class Answer:
    """The answer of a method to a batch, of whichever benchmark.

    Attributes:
        batch: What it was asked, at the table's rate.
        motions: Motions or futures, float32, as the harness accepts them (but for their distance from the origin); else
            None.
        error: The reason, as the harness words it.
        returned: The object that the method itself returned.
        answered: True if the method returned without raising.
        drew_from: Global generators whose state moved.
        n_samples: Futures of each window that a predictor was asked for.
    """

    batch: Any
    motions: Any
    error: str = ""
    returned: object = None
    answered: bool = False
    seconds: float = 0.0
    drew_from: tuple[str, ...] = ()
    n_samples: int = 1

    def motion(self, row: int) -> Float[np.ndarray, "*frames joints 3"]:
        """Return what was answered to one row without padding, metres."""
        joints = self.motions.joints[row]
        lengths = getattr(self.batch, "n_frames", None)
        return joints if lengths is None else joints[: int(lengths[row])]


def program_misshaped(answer: Answer) -> bool:
    """Return True where a program's payload was refused before it became motions."""
    return not answer.answered and "that cannot be used" in answer.error


@dataclass
class _Watched:
    """Wraps a method and records what goes in and what comes out."""

    adapter: Adapter
    returned: object = None
    answered: bool = False
    drew_from: set[str] = field(default_factory=set)
    seconds: float = 0.0

    def __getattr__(self, name: str) -> object:
        return getattr(self.adapter, name)

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        """Generate, and compare the global generators with what they were."""
        states = generator_states()
        started = time.perf_counter()
        try:
            self.returned = self.adapter.generate(batch, seed=seed)
            self.answered = True
        finally:
            self.seconds += time.perf_counter() - started
            self.drew_from.update(generators_touched(states))
        return self.returned  # type: ignore[return-value] - whatever it is, the harness checks it


def ask(adapter: Adapter, batch: ConditionBatch, *, seed: int, state_seed: int, threads: int) -> Answer:
    """Call the method as a run does; whatever it raises becomes part of the answer.

    Args:
        adapter: The method.
        batch: What it is asked, at the table's rate.
        seed: The run's seed.
        state_seed: Seed of the global generators.
        threads: Threads of NumPy's and torch's libraries.
    """
    watched = _Watched(adapter)
    motions = None
    error = ""
    # A method may keep or change its batch; the answer holds the one that was meant.
    own = dataclasses.replace(batch)
    try:
        with computing_threads(threads), generators_set_to(state_seed):
            motions, _ = generate_checked(
                watched,  # type: ignore[arg-type] - its other attributes are the method's
                own,
                seed=seed,
                method=str(getattr(adapter, "name", "?")),
                sequence_ids=[f"#{row}" for row in range(len(batch))],
                farthest=math.inf,  # how far out a body is, and in which unit, is the doctor's to say
            )
    except PrbenchError as raised:
        error = str(raised)
    call = (watched.returned, watched.answered, watched.seconds, tuple(sorted(watched.drew_from)))
    return Answer(batch, motions, error, *call)


def largest_changes(first: Answer, second: Answer, rows: list[int] | None = None) -> Float[np.ndarray, " rows"]:
    """Return for each motion the largest distance of any joint in any frame between two answers, metres.

    Args:
        first: Any answer with motions.
        second: Answers rows of the same lengths.
        rows: Row of ``first`` that each row of ``second`` belongs to; None for the same order.
    """
    places = range(len(second.batch)) if rows is None else rows
    apart = [first.motion(place) - second.motion(row) for row, place in enumerate(places)]
    return np.array([float(np.linalg.norm(each, axis=-1).max()) for each in apart])


def same_bytes(first: Answer, second: Answer) -> bool:
    """Return True if two answers to the same batch hold the same numbers to the last bit."""
    return all(np.array_equal(first.motion(row), second.motion(row)) for row in range(len(first.batch)))


def metres(distance: float) -> str:
    """Write a distance in a unit that is easy to read.

    >>> metres(0.034)
    '3.4 cm'
    """
    if distance >= 1:
        return f"{distance:.2f} m"
    if distance >= 0.001:
        return f"{distance * 100:.1f} cm"
    return f"{distance:.1e} m" if distance else "0 m"


_FIRST = "first-motions.npy"
_FEW = 2  # cases that even a slow method is asked about
_BATCH_SECONDS = 12.0  # seconds that a batch should take


class MethodSubject(ABC):
    """A method, and the cases that it is asked about.

    Args:
        spec: How to make the method.
        folder: Folder in which a method that learns may leave what it learnt.

    Attributes:
        case: What it is asked about, for messages: ``sequence`` or ``window``.
        things: What it answers.
        asks: Name of the check that asks it under every condition.
        shape: The shape that is asked for, in words.
        shape_remedy: How an answer has that shape.
        own_generators: How a method draws so that nothing decides but what may.
        own_row: How the rows of a batch are kept apart.
    """

    case: ClassVar[str]
    things: ClassVar[str] = "motions"
    asks: ClassVar[str]
    shape: ClassVar[str]
    shape_remedy: ClassVar[str]
    own_generators: ClassVar[Remedy]
    own_row: ClassVar[str]

    def __init__(self, spec: MethodSpec, folder: Path) -> None:
        self.spec = spec
        self.folder = folder
        self.drew_from: set[str] = set()  # Global generators whose state it moved
        # Called before each call of the method, with a text that describes it
        self.asking: Callable[[str], None] = lambda _text: None
        # Called with a text that describes the work before the first call
        self.starting: Callable[[str], None] = lambda _text: None
        self._answers: dict[StrEnum, Any] = {}

    @property
    @abstractmethod
    def conditions(self) -> tuple[Any, ...]:
        """The conditions that it declares, the richest first."""

    @property
    @abstractmethod
    def n_cases(self) -> int:
        """Number of cases that it can be asked about."""

    @abstractmethod
    def learns(self, loaded: LoadedMethod) -> bool:
        """Return True for a method that learns from a table."""

    @abstractmethod
    def fitted_spec(self) -> MethodSpec:
        """Return how to make the method fitted to the training cases."""

    @abstractmethod
    def is_misshapen(self, answer: Answer) -> bool:
        """Return True if an answer is none, or has another shape than was asked for."""

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
        answer: Answer = self.ask(self.batch(range(min(2, self.n_cases)), self.conditions[0]))
        kept = self.folder / _FIRST
        if answer.motions is not None and not kept.is_file():
            np.save(kept, answer.motions.joints)
        return answer

    def first_motions(self) -> Float[np.ndarray, "batch *frames joints 3"] | None:
        """Return the answer to the very first batch in the first process, or None if there is none."""
        kept = self.folder / _FIRST
        return load_array(kept) if kept.is_file() else None

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """The cases of a usual batch: all, or a few of the shorter ones if the method is slow."""
        total = self.n_cases
        # The first call also pays for loading; only the second tells how slow the method is.
        second: Answer = self.ask(self.first_answer.batch)
        number = int(np.clip(_BATCH_SECONDS * len(second.batch) / max(second.seconds, 1e-9), min(_FEW, total), total))
        last = total - 1 if number == total else total // 2
        return tuple(int(row) for row in np.unique(np.linspace(0, last, number).round().astype(int)))

    def standard(self, condition: Any) -> Any:
        """Return the answer to the usual batch of a condition."""
        if condition not in self._answers:
            self._answers[condition] = self.ask(self.batch(self.rows, condition))
        return self._answers[condition]


# The condition that most checks use is the first of these that works
RICHEST_FIRST = (Condition.GOAL_LOCATION, Condition.GOAL_POSE, Condition.TEXT, Condition.NONE)
_SALT = run_salt(0, "conformance")
OWN_GENERATORS = Remedy(
    "Draw from one generator a sequence, made of its noise_seed alone:"
    " prbench.randomness.sequence_generator(noise_seed), or torch.Generator().manual_seed(noise_seed).",
    "Draw from one generator a sequence, made of the noise_seed of its row alone (numpy.random.default_rng(noise_seed),"
    " SplitMix64 …).",
)


_SHAPES = Remedy(
    "Return prbench.contract.Motions(joints, batch.n_frames): joints is a NumPy array (sequences, frames, 22, 3) with"
    " at least batch.n_frames.max() frames; behind a shorter motion stands padding.",
    "Send one row a sequence: its opaque_id, and joints with exactly n_frames times 66 numbers, frame by frame and"
    " joint by joint, without padding (docs/wire-protocol.md).",
)


class Subject(MethodSubject):
    """A method of prime-and-reach, and the sequences that it is asked about.

    Args:
        spec: How to make the method.
        cases: What it is asked about.
        folder: Folder in which a method that learns may leave what it learnt.
    """

    case = "sequence"
    asks = "generates"
    shape = "(sequences, frames, 22, 3) with the asked lengths"
    shape_remedy = _SHAPES
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
        table = self.cases.folder
        if self.spec.program is not None:
            return fitted_to(self.spec, SequenceTable.open(table).with_sequences())
        return replace(self.spec, fit_folder=self.folder / "fit", table_folder=table, fit=fit_to_training_rows)

    def is_misshapen(self, answer: Answer) -> bool:
        """See :meth:`MethodSubject.is_misshapen`."""
        if answer.motions is not None:
            return False
        returned = answer.returned
        if program_misshaped(answer) or not isinstance(returned, Motions):
            return True
        if not isinstance(returned.joints, np.ndarray):
            return True
        if np.issubdtype(returned.joints.dtype, np.floating):
            return "expected finite positions" not in answer.error
        return "with decimals" not in answer.error or returned.joints.ndim != 4 or returned.joints.shape[2:] != (22, 3)

    @property
    def n_cases(self) -> int:
        """See :attr:`MethodSubject.n_cases`."""
        return len(self.source.n_frames)

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
        if (rate := self.declared.native_fps) is not None:
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
        frames = f"{of_one} of up to {int(batch.n_frames.max())} frames"
        self.asking(f"while it generated {frames} under {batch.condition.value}")
        answer = ask(self.adapter, batch, seed=seed, state_seed=state_seed, threads=self.spec.threads)
        self.drew_from.update(answer.drew_from)
        return answer
