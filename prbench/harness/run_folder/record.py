"""``run.json``: everything that decides what a run computes, and the comparison that keeps two runs apart.

``cost.json``: seconds and memory measured by the harness, network passes declared by the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec

from prbench.engine.shards import flat_leaves
from prbench.errors import RunError
from prbench.files.bounded import foreign_input, read_whole
from prbench.files.storage import text_digest, write_json
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.limits import LARGEST_JSON
from prbench.protocol.manifests import default_benchmark
from prbench.shown import clean

FILE_NAME = "run.json"
Record = TypeVar("Record")
SchemaVersion = Annotated[int, msgspec.Meta(ge=RUN_SCHEMA_VERSION, le=RUN_SCHEMA_VERSION)]

BUILT_IN = "built-in"
CONTROL = "control"
PACKAGE = "package"
PROGRAM = "program"
FILE = "file"
# Kinds of methods: prbench's own, the harness's controls, a foreign package, a program (``cmd:`` or a TOML file),
# motions that came as a file; and what an old record does not say.
UNKNOWN = "unknown"


class MethodRecord(msgspec.Struct, frozen=True, kw_only=True):
    """A method in a certain version.

    Attributes:
        name: Its name.
        kind: One of the kinds above. Names are checked by it: only prbench's own methods and controls bear their names.
        package: Package that a method was installed from; of a program its command, without the folders of the machine;
            of motions the name of their file.
        version: Version of the package.
        weights: Last part of the path of the weights in use, given or bundled, for people.
        weights_digest: Digest of its weights; null without weights.
        options: Its options by name.
        max_frames: Frames of the longest motion that it can generate; null without a limit.
        native_fps: Frames per second at which it generates; null for any rate.
        motionless: The method declares that its motions stand still, so that Foot Skating says nothing about it.
        gaze: The motions bring gaze (docs/specification/protocol.md#gaze).
        wants_obstacles: True in runs up to 0.10 whose method was given the solid boxes around each sequence; those are
            never ranked.
        one_design: The K futures of a window are one design, so that fewer have no scores; not written where they are
            none.
        isolation: ``process`` (paths, objects and environment withheld), ``bubblewrap`` (the file system too) or
            ``container``.
    """

    name: str
    kind: str = UNKNOWN
    package: str
    version: str
    weights: str | None
    weights_digest: str | None
    options: dict[str, str]
    max_frames: int | None
    native_fps: float | None
    motionless: bool
    gaze: bool = False
    wants_obstacles: bool = False
    one_design: bool = False
    isolation: str | None = None

    @classmethod
    def of_file(cls, name: str, file: str, digest: str, **declared: Any) -> MethodRecord:
        """Return the record of finished motions or futures in a file; ``declared`` are other fields."""
        return cls.bare(name, FILE, file, digest[:12], **declared)

    @classmethod
    def bare(cls, name: str, kind: str, package: str, version: str, **declared: Any) -> MethodRecord:
        """Return the record of a method without weights, options and limits, apart from what is ``declared``."""
        nothing: dict[str, Any] = {"weights": None, "weights_digest": None, "options": {}, "motionless": False}
        nothing |= {"max_frames": None, "native_fps": None}
        return cls(name=name, kind=kind, package=package, version=version, **nothing | declared)

    @property
    def origin(self) -> str:
        """Origin of the method, from where, and how it was kept apart, in words for tables."""
        source = clean(self.package)
        words = {
            BUILT_IN: "built in",
            CONTROL: "control",
            PACKAGE: f"package {source} {clean(self.version)}",
            PROGRAM: f"program {source}",
            FILE: f"file {source}",
        }
        apart = f", isolated: {clean(self.isolation)}" if self.isolation else ""
        return words.get(self.kind, "unknown kind") + apart


class BatchPlanRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The groups of sequences; floating-point results may depend on them.

    Attributes:
        batch_size: Sequences a batch at most.
        batches: Number of batches.
        digest: Over the sequence ids of every batch, in order.
    """

    batch_size: int
    batches: int
    digest: str


class TableRecord(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """The sequences of a table that a run was made on.

    Attributes:
        dataset: Name of the dataset.
        title: The same for readers.
        synthetic: The people are synthetic.
        redistribution: Whether data made from the dataset may be passed on: ``yes``, ``non-commercial`` or ``none``.
        fold: The fold of participants that was tested on, such as ``2/6``; absent for a table that is no fold.
        whole_table: Content digest of the table that the fold is of; absent for a table that is no fold.
        units: Participant of each recording that a fold tested on, by ``dataset/recording``; of merged folds the units
            of intervals and comparisons. Absent where recordings are the units.
        identity_digest: Digest of the ids of its sequences.
        content_digest: Digest of its content.
        sequences: Chosen by split and limit.
        unsupported: Number of them that are longer than the method can generate.
        selection_digest: Over the ids of the chosen sequences.
        batch_plan: How its sequences were grouped.
        estimated_bodies: Bodies were estimated from whole tracks of the head; never enters one mean with captured ones.
    """

    dataset: str
    title: str
    synthetic: bool
    redistribution: str
    fold: str | None = None
    whole_table: str | None = None
    units: dict[str, str] = {}
    identity_digest: str
    content_digest: str
    sequences: int
    unsupported: int
    selection_digest: str
    batch_plan: BatchPlanRecord
    estimated_bodies: bool = False

    def unit_of(self, recording: str) -> str:
        """Return the name of what does not depend on others: of merged folds the participant, else the recording.

        Args:
            recording: Its name, ``dataset/recording``.
        """
        # Within one fold there may be one participant alone, and the recordings are all that can be told apart.
        return recording if self.fold is not None else self.units.get(recording, recording)


class RunRecord(msgspec.Struct, frozen=True, kw_only=True):
    """The whole of ``run.json``. Holds no time of day, host, absolute path or worker count.

    Attributes:
        schema_version: Version of the files of a run folder.
        prbench_version: Version of prbench that made the run.
        protocol_version: Version of the protocol.
        protocol_digest: Digest of the rules by which it was scored.
        method: The method.
        condition: What it was given.
        control: ``shuffled-goal`` if it was given other sequences' goals; null if not.
        split: Split of the tables.
        limit: Sequences of each dataset at most; null for all.
        sequences: Ids, if the run is of single sequences instead of a split's; sorted.
        seed: Seed of the run.
        samples: Motions kept of each sequence.
        best_of: Above 1 in runs up to 0.10 whose motions were chosen among several; those are never ranked.
        carry_on: True in runs up to 0.10 whose puts started where generated picks ended; those are never ranked.
        device: Device that networks ran on.
        threads: Threads of each worker.
        packages: Versions of the packages that it was made with.
        tables: The tables that it was made on.
        benchmark: Name of the benchmark; not written for the default one, whose runs are older than the key.
    """

    schema_version: SchemaVersion
    prbench_version: str
    protocol_version: int
    protocol_digest: str
    method: MethodRecord
    condition: str
    control: str | None
    split: str
    limit: Annotated[int, msgspec.Meta(ge=1)] | None
    sequences: tuple[str, ...] = ()
    seed: Annotated[int, msgspec.Meta(ge=0)]
    samples: Annotated[int, msgspec.Meta(ge=1)]
    best_of: int = 1
    carry_on: bool = False
    device: str
    threads: int
    packages: dict[str, str]
    tables: Annotated[tuple[TableRecord, ...], msgspec.Meta(min_length=1)]
    benchmark: str = msgspec.field(default_factory=lambda: default_benchmark().name)

    @property
    def is_usual(self) -> bool:
        """False for motions that were chosen, bring gaze, knew more than others or started elsewhere: never ranked."""
        adds_or_knows_more = self.method.gaze or self.method.wants_obstacles
        return self.best_of == 1 and not adds_or_knows_more and not self.carry_on

    def write(self, folder: Path) -> None:
        """Write ``run.json``."""
        write_json(folder / FILE_NAME, self.written)

    @property
    def written(self) -> dict[str, Any]:
        """The values of ``run.json``: keys that are younger than its format are left out where they say the usual."""
        values = msgspec.to_builtins(self)
        if self.benchmark == default_benchmark().name:
            del values["benchmark"]
        if not self.method.one_design:
            del values["method"]["one_design"]
        return values

    @property
    def short_digest(self) -> str:
        """Digest in the name of a run folder that the user did not name."""
        text = repr(self).replace(", one_design=False", "").replace(", units={}", "")
        if self.benchmark == default_benchmark().name:
            # Folders of earlier versions, whose records named no benchmark, are to be found again.
            text = text.replace(f", benchmark={self.benchmark!r}", "")
        return text_digest(text)[:8]

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> RunRecord:
        """Read ``run.json``.

        Raises:
            RunError: if the folder holds none, or it is damaged or of another version.
        """
        missing = f"{folder}: expected a run folder (with {FILE_NAME}), found no such file in it."
        record = read_record(folder / FILE_NAME, cls, missing=missing, remedy="Choose another folder for --out.")
        # A record of prbench 0.5 or older, which told neither own methods from foreign ones nor called a file a file.
        method = record.method
        if method.kind == "adapter":
            kind = BUILT_IN if method.package == "prbench" else PACKAGE
        elif method.kind == "offline":
            kind = FILE
        else:
            return record
        return msgspec.structs.replace(record, method=msgspec.structs.replace(method, kind=kind))

    def require_same(self, other: RunRecord, folder: Path) -> None:
        """Refuse to go on in a folder that belongs to other inputs.

        Args:
            other: What stands in the folder.
            folder: The run folder, for the message.

        Raises:
            RunError: naming the first key that differs, with both values.
        """
        wanted = flat_leaves(self.written)
        found = flat_leaves(other.written)
        # In the order of the record, so that the first difference named is the most telling one.
        for key in wanted | found:
            if wanted.get(key) != found.get(key):
                problem = f"expected {_shown(wanted.get(key))} for this run, found {_shown(found.get(key))}."
                remedy = "The folder belongs to another run; choose another folder for --out, or delete this one."
                raise RunError(f"{folder / FILE_NAME}, {key}: {problem} {remedy}")


def read_record(
    path: Path, kind: type[Record], *, missing: str, remedy: str = "Delete it and run the method again."
) -> Record:
    """Read one of the JSON files of a run.

    Args:
        path: The file.
        kind: What it holds.
        missing: The message if there is no such file.
        remedy: What to do about a file that holds something else.

    Raises:
        RunError: if it is missing, damaged or of another version.
    """
    try:
        return msgspec.json.decode(read_whole(path, largest=LARGEST_JSON), type=kind)
    except FileNotFoundError as error:
        raise RunError(missing) from error
    except (msgspec.ValidationError, msgspec.DecodeError) as error:
        raise RunError(f"{path}: not a valid {path.name}: {error}. {remedy}") from error


def _shown(value: object) -> str:
    text = "nothing" if value is None else str(value)
    return f"{text[:12]}…" if len(text) == 64 else text


# What no machine undercuts: memory of a Python process with NumPy, and the harness's own work on a frame, for which one
# core of 2026 needs over 500 ns; and the processors that none exceeds.
_LEAST_MEMORY = 16 * 2**20
_SECONDS_A_FRAME = 20e-9
_PROCESSORS = 1024


class RunCost(msgspec.Struct, frozen=True, kw_only=True):
    """``cost.json``, of a run or of one of its batches. Not reproducible, unlike the other files of a run.

    The first batch of a process also pays for compilation and for weights that load on first use: it is warm-up.

    Attributes:
        motions: Generated motions that were timed, without warm-up.
        seconds: Seconds of ``generate`` alone, device synchronised, without warm-up.
        processor_seconds: Processor time of the same in this process and all that it has started, of all threads; None
            where it cannot be measured (a container), and in runs of earlier versions.
        parameters: Parameters of the method's networks; None for a program, and in runs of earlier versions.
        checksum: Digest of the other values, by which an edited or damaged number is noticed; empty until written.
    """

    motions: int = 0
    frames: int = 0
    seconds: float = 0.0
    processor_seconds: float | None = None
    seconds_per_motion: float | None = None
    warm_up_motions: int = 0
    warm_up_frames: int = 0
    warm_up_seconds: float = 0.0
    warm_up_processor_seconds: float | None = None
    peak_process_bytes: int = 0
    peak_device_bytes: int | None = None
    network_passes_declared: int | None = None
    parameters: int | None = None
    checksum: str = ""

    def write(self, path: Path) -> None:
        """Write as JSON, with a checksum."""
        write_json(path, msgspec.to_builtins(msgspec.structs.replace(self, checksum=self._sum)))

    @property
    def _sum(self) -> str:
        """Checksum that the numbers should have."""
        return text_digest(repr(msgspec.structs.replace(self, checksum="")))

    def problem(self, record: RunRecord, table: TableRecord) -> str:
        """Say why these numbers cannot be what the harness measured; empty where nothing contradicts them.

        Args:
            record: The run.
            table: The table that the cost is of.
        """
        numbers = [value for value in msgspec.to_builtins(self).values() if isinstance(value, int | float)]
        if not any(numbers):
            return ""  # nothing was measured, such as of motions that came as a file
        if self.checksum != self._sum:
            return "its checksum is not that of its numbers" if self.checksum else "it has no checksum (up to 0.10)"
        motions = self.motions + self.warm_up_motions
        frames = self.frames + self.warm_up_frames
        scored = (table.sequences - table.unsupported) * record.samples
        seconds = self.seconds + self.warm_up_seconds
        processors = (self.processor_seconds or 0) + (self.warm_up_processor_seconds or 0)
        memory = self.peak_process_bytes + (self.peak_device_bytes or 0)
        one = self.seconds / self.motions if self.motions else 0.0
        passes = table.batch_plan.batches * record.samples
        timed = record.method.kind != CONTROL  # the harness makes their motions itself
        checks = (
            (any(not 0 <= value < inf for value in numbers), "expected numbers from 0 on, found others"),
            (motions != scored, f"expected {scored} motions, as were scored, found {motions}"),
            (abs((self.seconds_per_motion or 0.0) - one) > 1e-6 * one, f"its sums say {one:.6g} s a motion, not it"),
            (memory < max(_LEAST_MEMORY, self.parameters or 0), f"{memory} bytes hold no Python with its parameters"),
            ((self.network_passes_declared or passes) < passes, f"{passes} batches need a network pass each"),
            (timed and seconds < frames * _SECONDS_A_FRAME, f"{seconds:.3g} s are too few to check {frames} frames"),
            (processors > _PROCESSORS * seconds, f"{processors:.3g} s of processors are too many in {seconds:.3g} s"),
        )
        return next((words for wrong, words in checks if wrong), "")

    @classmethod
    @foreign_input()
    def read(cls, path: Path) -> RunCost:
        """Read ``cost.json``, or the measurement of a batch.

        Raises:
            RunError: if it is missing or damaged.
        """
        missing = f"{path}: expected the cost of a run, found no file. Run the method again: it resumes."
        return read_record(path, cls, missing=missing)


def total_cost(costs: Sequence[RunCost]) -> RunCost:
    """Sum up the costs of batches, or of runs."""

    def known(name: str) -> list[int]:
        return [value for cost in costs if (value := getattr(cost, name)) is not None]

    def computed(name: str, motions: str) -> float | None:
        parts = [getattr(cost, name) for cost in costs if getattr(cost, motions)]
        return sum(parts) if parts and None not in parts else None

    sums: dict[str, Any] = {
        name: sum(getattr(cost, name) for cost in costs)
        for name in ("motions", "frames", "seconds", "warm_up_motions", "warm_up_frames", "warm_up_seconds")
    }
    return RunCost(
        **sums,
        processor_seconds=computed("processor_seconds", "motions"),
        warm_up_processor_seconds=computed("warm_up_processor_seconds", "warm_up_motions"),
        seconds_per_motion=sums["seconds"] / sums["motions"] if sums["motions"] else None,
        peak_process_bytes=max((cost.peak_process_bytes for cost in costs), default=0),
        peak_device_bytes=max(known("peak_device_bytes"), default=None),
        network_passes_declared=sum(known("network_passes_declared")) or None,
        parameters=max(known("parameters"), default=None),
    )
