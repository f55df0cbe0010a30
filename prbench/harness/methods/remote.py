"""A program behind the wire protocol (docs/wire-protocol.md) as the harness sees any other method of its benchmark."""

from __future__ import annotations

import importlib
import math
import re
import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import prbench
from prbench.contract import ENTRY_POINT_GROUP, Adapter, Condition, ConditionBatch, Cost, Motions, TrainingRun
from prbench.errors import AdapterError
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.methods.installed import NAME_FORM, has_form
from prbench.harness.methods.messages import (
    WIRE_VERSION,
    Header,
    batch_of,
    conditions_payload,
    motions_of,
    motions_payload,
    shown_json,
)
from prbench.harness.methods.motions import Declared, asked_for, own_copy, well_formed
from prbench.harness.methods.process import Fault, Program, ProgramProcess
from prbench.harness.methods.training_split import TrainingSplit
from prbench.protocol.manifests import find_benchmark
from prbench.sequences import DatasetInfo

_SHOWN_TEXT = 2000  # characters of what a program says about its own error
_TEXT_LIMIT = 100
_Answer = TypeVar("_Answer")
_Read = Callable[[Header, bytes | None, int], Any]


def motions_in(
    header: Header, payload: bytes | None, batch: ConditionBatch, number: int, *, gaze: bool = False
) -> Motions:
    """Return the motions of an answer, in the order of the batch.

    Args:
        header: Header as it was received.
        payload: Payload as it was received.
        batch: What was asked for.
        number: Number of the request.
        gaze: The program declares gaze.

    Raises:
        Fault: see :func:`answer_in`.
        MemoryError: see :func:`answer_in`.
    """
    motions = answer_in(header, payload, number, due="motions", read=lambda sent: motions_of(sent, batch, gaze=gaze))
    passes = header.get("network_passes")
    if passes is None:
        return motions
    if type(passes) is not int or passes < 0:
        raise Fault(f"declared {shown_json(passes)} network_passes, where a whole number of 0 or more was due")
    return replace(motions, cost=Cost(passes))


def answer_in(
    header: Header, payload: bytes | None, number: int, *, due: str, read: Callable[[bytes], _Answer]
) -> _Answer:
    """Return what an answer holds.

    Args:
        header: Header as it was received.
        payload: Payload as it was received.
        number: Number of the request.
        due: The message that answers it, ``motions`` or ``futures``.
        read: Turns the payload into the answer; raises ValueError where it cannot.

    Raises:
        Fault: if the program says that it failed, or answers something else than it was asked for.
        MemoryError: if it says that the batch does not fit in memory.
    """
    kind = header["message"]
    if kind not in (due, "error"):
        raise Fault(f"answered with the message {kind[:80]!r}, where '{due}' or 'error' was due")
    found = header.get("batch")
    if (type(found) is not int or found != number) and not (found is None and kind == "error"):
        answered = "without the number of a batch" if found is None else f"batch {shown_json(found)}"
        why = "every request has exactly one answer, which repeats its number"
        raise Fault(f"answered {answered}, where batch {number} was due: {why}")
    if kind == "error":
        text = error_text(header)
        out_of_memory = header.get("out_of_memory")
        if out_of_memory is not None and not isinstance(out_of_memory, bool):
            shown = shown_json(out_of_memory)
            raise Fault(f"reported the error '{text}' with 'out_of_memory' {shown}, where true or false was due")
        if out_of_memory:
            raise MemoryError(text)
        raise Fault(f"reported an error: {text}", kind="reported")
    if payload is None:
        raise Fault(f"answered without a payload, where 'bytes' and as many bytes of {due} were due")
    try:
        return read(payload)
    except ValueError as error:
        raise Fault(f"sent {due} that cannot be used: {error}") from error


def error_text(header: Header) -> str:
    """Return what a program says about its own error, without what would move the cursor or colour a terminal.

    Raises:
        Fault: if it is no text.
    """
    text = header.get("text")
    if text is not None and not isinstance(text, str):
        raise Fault(f"reported an error with the 'text' {shown_json(text)}, where a string was due")
    said = "" if text is None else text.expandtabs(4).strip()[:_SHOWN_TEXT]
    shown = "".join(
        letter if letter.isprintable() or letter == "\n" else "\N{REPLACEMENT CHARACTER}" for letter in said
    )
    return shown or "no reason given"


@dataclass(frozen=True)
class Introduction:
    """A program's hello.

    Attributes:
        weights: Name and SHA-256 of the weights that it says it uses under each condition.
        trainable: True if the installed method can be fitted to a table; only prbench's own worker says so.
    """

    name: str
    version: str
    declared: Declared
    weights: Mapping[StrEnum, tuple[str, str]] = field(default_factory=dict)
    trainable: bool = False

    @classmethod
    def read(cls, header: Mapping[str, Any], *, origin: str, conditions: type[StrEnum] = Condition) -> Introduction:
        """Read the header of a ``hello``.

        Args:
            header: Header as it was received.
            origin: Name of the program in messages.
            conditions: The conditions of its benchmark.

        Raises:
            AdapterError: naming the key that is not what the protocol asks for.
        """
        if header["message"] != "hello":
            problem = f"expected it to answer 'hello' with 'hello', found the message {header['message'][:80]!r}."
            raise AdapterError(f"{origin}: {problem}")
        wire = header.get("wire")
        if type(wire) is not int or wire != WIRE_VERSION:
            remedy = f"Send the whole number {WIRE_VERSION}"
            if type(wire) is int:
                remedy = "Update prbench" if wire > WIRE_VERSION else "Update the program"
            why = f"('wire' in its hello), found {_shown(wire)}. {remedy}."
            raise AdapterError(f"{origin}: expected version {WIRE_VERSION} of the wire protocol {why}")
        version = header.get("version")
        is_text = isinstance(version, str) and version.strip() and version.isprintable()
        fits_version = is_text and len(str(version)) <= _TEXT_LIMIT
        form = 'name and sha256 (64 hexadecimal digits), as {"goal-loc": {"name": …, "sha256": …}}'
        stated = header.get("weights")
        weights, fits = _weights({} if stated is None else stated, conditions)
        flags = ("motionless", "gaze", "one_design")
        checks: list[tuple[str, Any, str]] = [
            *((flag, isinstance(header.get(flag), bool | None), "be true or false") for flag in flags),
            ("name", has_form(header.get("name")), f"be a text of {NAME_FORM}"),
            ("version", fits_version, f"be a text of 1 to {_TEXT_LIMIT} printable characters"),
            ("conditions", isinstance(header.get("conditions"), list), "be an array of strings"),
            ("weights", fits, f"give a condition's {form}"),
        ]
        for key, holds, expected in checks:
            if not holds:
                found = _shown(header.get(key))
                raise AdapterError(f"{origin}: expected '{key}' in its hello to {expected}, found {found}.")
        declared = Declared.checked(header, origin=origin, known=conditions)
        return cls(str(header["name"]), str(version), declared, weights, trainable=header.get("trainable") is True)


def _weights(stated: object, conditions: type[StrEnum]) -> tuple[dict[StrEnum, tuple[str, str]], bool]:
    """Return name and digest of the weights of each condition, and True if they are of the right form."""
    known = {condition.value: condition for condition in conditions}
    weights = {}
    for condition, entry in stated.items() if isinstance(stated, dict) else [("", None)]:
        name, digest = (entry.get("name"), entry.get("sha256")) if isinstance(entry, dict) else (None, None)
        is_digest = isinstance(digest, str) and re.fullmatch("[0-9a-f]{64}", digest)
        if condition not in known or not isinstance(name, str) or not is_digest:
            return {}, False
        weights[known[condition]] = (name, str(digest))
    return weights, True


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 120 else text[:120] + "…"


_MEGABYTE = 1 << 20
_SLOW_BATCH = " Let it answer faster, lower --batch-size, or raise the limit with --timeout."
_SLOW_START = (
    " Let it load its weights with the first batch, or raise start_s under [limits] in a TOML file for it"
    " (docs/environments.md)."
)


class RemoteMethod:
    """A method of any benchmark in a process of its own; made by :meth:`start`.

    A program that crashes, misses a time limit or breaks the protocol fails its batch. It ends with :meth:`close`, with
    the interpreter, or when nobody holds this object any more.

    Attributes:
        all_conditions: The conditions of the benchmark.
        said: What the hello says besides.
    """

    all_conditions: ClassVar[type[StrEnum]]
    said: ClassVar[Mapping[str, Any]] = {}

    def __init__(self, program: Program, hello: Header) -> None:
        self._program, self._hello = program, hello
        self._closed = False
        introduction = self._launch(f"method '{program.name}'")
        self.name, self.version = introduction.name, introduction.version
        self.conditions: frozenset[Any] = introduction.declared.conditions
        self.max_frames, self.native_fps = introduction.declared.max_frames, introduction.declared.native_fps
        self.motionless = introduction.declared.motionless
        self.gaze = introduction.declared.gaze
        self.one_design = introduction.declared.one_design
        # Name and SHA-256 of the weights that it says it uses under each condition; empty if it says nothing
        self.weights: Mapping[StrEnum, tuple[str, str]] = introduction.weights
        self.trainable = introduction.trainable

    @classmethod
    def start(
        cls, program: Program, *, weights: str | None, options: Mapping[str, str], device: str, threads: int
    ) -> Self:
        """Start the program and let it introduce itself.

        Args:
            program: How to start it.
            weights: An absolute path, or a name that the program knows, or None for its default.
            options: ``--option key=value``, handed on as they are.
            device: ``cpu``, ``cuda`` …
            threads: Threads that it may use.

        Raises:
            AdapterError: if it cannot be started, refuses its settings, or does not introduce itself in time and as
                the protocol asks for.
        """
        settings = {"device": device, "threads": threads, "options": dict(options), "weights": weights}
        hello = {"message": "hello", "wire": WIRE_VERSION, "prbench": prbench.__version__, **cls.said, **settings}
        return cls(program, hello)

    def exchange(self, header: Header, payload: bytes, read: _Read, *, largest: int, ids: Any) -> Any:
        """Ask the program.

        Args:
            header: Header of the request, without the number of the batch.
            payload: Payload of the request.
            read: Turns header, payload and the number of the batch into the answer.
            largest: Most bytes of the answer's payload.
            ids: Names of the rows, for messages.

        Raises:
            AdapterError: if it fails, crashes, answers too late or with something else than the protocol asks for. The
                program is ended then, unless it reported the failure itself.
            MemoryError: if it says that the batch does not fit in memory.
        """
        origin = f"method '{self.name}'"
        if self._closed:
            raise AdapterError(f"{origin}: asked for motions after its program was closed.")
        if self._process.over:  # after a failure that the caller has survived
            self._launch(origin)
        number = self._batches
        self._batches += 1
        try:
            numbered = {"message": header["message"], "batch": number, **header}
            timeout = self._program.batch_timeout
            answer, sent = self._process.ask(numbered, payload, timeout=timeout, answer_limit=largest + _MEGABYTE)
            return read(answer, sent, number)
        except Fault as fault:
            if fault.kind not in ("ended", "reported"):
                self._process.kill()
            raise AdapterError(self._told(origin, fault, asked_for(ids))) from fault

    def close(self) -> None:
        """End the program. May be called again."""
        self._closed = True
        self._finalizer()

    def _launch(self, origin: str) -> Introduction:
        process = self._process = ProgramProcess(self._program)
        self._finalizer = weakref.finalize(self, process.close)
        self._batches = 0
        try:
            answer, _ = process.ask(self._hello, timeout=self._program.start_timeout, answer_limit=_MEGABYTE)
            if answer["message"] == "error":
                raise Fault(f"refused to start: {error_text(answer)}", kind="reported")
            return Introduction.read(answer, origin=origin, conditions=self.all_conditions)
        except Fault as fault:
            process.kill()
            told = self._told(f"{origin}, asked to introduce itself", fault, if_late=_SLOW_START)
            raise AdapterError(told) from fault
        except ValueError as error:  # options of more than 64 kB
            raise AdapterError(f"{origin}: its settings cannot be sent: {error}. Put them into a file.") from error
        except AdapterError as error:
            process.kill()
            raise AdapterError(f"{error}{_log_story(process, even_if_empty=False)}") from error

    def _told(self, origin: str, fault: Fault, asked: str = "", *, if_late: str = _SLOW_BATCH) -> str:
        """Describe a fault: what to do about it, what was asked for, and the end of the log."""
        text = f"{origin}: its program {fault}.".replace("..", ".")
        if fault.kind == "late":
            text += if_late
        if fault.kind == "ended" and self._program.fence is not None:
            text += (
                f" It ran apart (--isolate, {self._program.fence}): paths and variables of this machine may be hidden."
            )
        return text + asked + _log_story(self._process, even_if_empty=fault.kind in ("ended", "late"))


def _log_story(process: ProgramProcess, *, even_if_empty: bool) -> str:
    lines = process.log_tail()
    if not lines:
        return " It wrote nothing to its log (stderr)." if even_if_empty else ""
    return "\n".join([f" The end of the log, {process.log_path}:", *(f"    {line}" for line in lines)])


class RemoteAdapter(RemoteMethod):
    """Satisfies :class:`prbench.contract.Adapter`."""

    all_conditions = Condition

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        """Ask the program for the motions of a batch; messages name sequences by their opaque ids.

        Raises:
            AdapterError: see :meth:`RemoteMethod.exchange`.
            MemoryError: see :meth:`RemoteMethod.exchange`.
        """
        header = {"message": "generate", "condition": batch.condition.value, "rows": len(batch)}
        header |= {"fps": float(batch.fps), "seed": seed}
        return self.exchange(
            header,
            conditions_payload(batch),
            lambda answer, payload, number: motions_in(answer, payload, batch, number, gaze=self.gaze),
            # Twice the size of joints and gaze in float64: room for any list type, and still a bound on what is read.
            largest=2 * len(batch) * int(batch.n_frames.max()) * (N_JOINTS + 2) * 3 * 8,
            ids=batch.opaque_id,
        )


def serve_motions(name: str, adapter: Adapter, header: Header, payload: bytes) -> tuple[Header, bytes]:
    """Answer a ``generate`` message.

    Args:
        name: Name of the method.
        adapter: The method.
        header: Header as it was received.
        payload: Payload as it was received.

    Returns:
        Header, without the number of the batch, and payload of the answer.
    """
    batch = batch_of(header, payload)
    motions = adapter.generate(own_copy(batch), seed=header["seed"])
    motions = well_formed(motions, batch, method=name, sequence_ids=batch.opaque_id, farthest=math.inf)
    passes = {} if motions.cost is None else {"network_passes": motions.cost.network_passes}
    return {"message": "motions", **passes}, motions_payload(batch.opaque_id, motions)


def fit_motions(adapter: Any, train: Path, run: TrainingRun) -> None:
    """Fit an installed method in its own process to the training rows in a folder, which may hold none."""
    adapter.fit(TrainingSplit(train, DatasetInfo.read(train)), validation=None, run=run)


@dataclass(frozen=True)
class MethodGroup:
    """What loading a method needs to know of its benchmark; picklable, so that every worker can load it.

    Attributes:
        entry_points: Entry-point group.
        interface: Protocol that a loaded method has to satisfy.
        members: What the protocol asks for, in words.
        conditions: The conditions that a method may name.
        remote: A method of the group behind the wire protocol.
        serve: Answers a request for an installed method in ``harness.methods.worker``: name, method, header, payload.
        fit: Fits an installed method there: method, folder of what it may learn from, where and how; None for a
            benchmark whose methods do not learn from a table.
    """

    entry_points: str
    interface: type
    members: str
    conditions: type[StrEnum]
    remote: type[RemoteMethod]
    serve: Callable[[str, Any, dict[str, Any], bytes], tuple[dict[str, Any], bytes]]
    fit: Callable[[Any, Path, TrainingRun], None] | None = None


# The methods of prime-and-reach
MOTIONS = MethodGroup(
    ENTRY_POINT_GROUP, Adapter, "name, conditions and generate()", Condition, RemoteAdapter, serve_motions, fit_motions
)


def group_of(benchmark: str) -> MethodGroup:
    """Return the methods of a benchmark; only that of the benchmark asked for is imported.

    Raises:
        UsageError: for an unknown benchmark.
    """
    about = find_benchmark(benchmark)
    if about.default:
        return MOTIONS
    module, _, attribute = about.value.partition(":")
    return getattr(importlib.import_module(module), attribute).methods
