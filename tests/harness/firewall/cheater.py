"""A method that cheats in every way that the contract leaves open; installed by the tests as a package of its own.

It generates no motion. Every attempt makes one claim a row, which only somebody can make who knows what a method must
not know; the claims' SHA-256 digests travel home in the returned joints, one attempt a frame. So the same file measures
a method in the harness's process, in one of its own, and behind a fence: nothing else comes back from there.

Beside it lies ``known.npz``, what a cheat may have brought along: ids, lengths, first poses and goals of the test
sequences, taken from a copy of the table.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import hmac
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import CellType, FrameType, FunctionType, GeneratorType, ModuleType

import numpy as np
import pyarrow.parquet as pq

from prbench.contract import Condition, ConditionBatch, Motions, TrainingRun
from prbench.errors import PrbenchError

Claims = list[str | None]
METHOD = b"prbench.harness.methods.worker"  # on the command line of an isolated one
N_LEAST = 50  # frames of the shortest motion, each of which can carry one attempt


class Cheater:
    """Claims instead of motions."""

    name = "cheater"
    conditions = frozenset(Condition)

    def __init__(self, options: Mapping[str, str]) -> None:
        self.options = options
        self.known = Known()
        self.learnt: dict[str, str | None] = {}
        self.seen: list[str] = []
        self.batches = 0

    def fit(self, train: object, *, validation: object, run: TrainingRun) -> None:
        """Take what a method that learns is handed, and try to get at the rows that it must not learn."""
        self.learnt = {name: attempted(attempt, train) for name, attempt in FITTING.items()}

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:
        n_frames, opaque = batch.n_frames.copy(), batch.opaque_id
        claims: dict[str, Claims] = {}
        for name, attempt in GENERATING.items():
            found = attempted(attempt, self, batch, seed)
            claims[name] = found if isinstance(found, list) else [found] * len(batch)
        claims |= {name: [value] * len(batch) for name, value in self.learnt.items()}
        self.seen += opaque
        self.batches += 1
        joints = np.zeros((len(batch), int(n_frames.max()) + 20, 22, 3))  # 20 frames more than anybody asked for
        for frame, name in enumerate(ATTEMPTS):
            for row, claim in enumerate(claims.get(name, [None] * len(batch))):
                joints[row, frame] = encoded(claim)
        return Motions(joints, n_frames)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> Cheater:
    """The entry point."""
    return Cheater(options)


def attempted(attempt: Callable, *arguments: object) -> Claims | str | None:
    """What an attempt finds; None if it meets a closed door."""
    try:
        return attempt(*arguments)
    except (Exception, PrbenchError):
        return None


def encoded(claim: str | None) -> np.ndarray:
    """A claim as numbers (22, 3) that survive float32: a mark, and the bytes of its digest.

    Bytes become decimetres, as the harness refuses coordinates that no room holds.
    """
    numbers = np.zeros(66)
    if claim is not None:
        numbers[0] = 1.0
        numbers[1:33] = np.array(list(hashlib.sha256(claim.encode()).digest())) / 10
    return numbers.reshape(22, 3)


# ---------------------------------------------------------------- what to claim


def test_rows(folder: Path) -> str | None:
    """Whoever has read the test rows of a table can say this."""
    if not (folder / "dataset.json").is_file():
        return None
    rows = [pq.read_table(path, columns=["sequence_id", "split"]) for path in sorted(folder.glob("sequences*"))]
    ids = [name for part in rows for name, split in zip(*map(list, part.to_pydict().values())) if split == "test"]
    return "\n".join(sorted(ids)) if ids else None


def first_table(places: Iterable[object]) -> str | None:
    """The claim of the first place that is a table's folder, or lies in one."""
    for place in places:
        text = os.fsdecode(place) if isinstance(place, str | bytes | os.PathLike) else ""
        if not text or len(text) > 4000 or "\0" in text:
            continue
        path = Path(text).expanduser()
        with contextlib.suppress(OSError, ValueError):
            for folder in (path, *path.parents):
                claim = test_rows(folder)
                if claim:
                    return claim
    return None


class Known:
    """What the cheat brought along, from a copy of the table."""

    def __init__(self) -> None:
        with np.load(Path(__file__).with_name("known.npz")) as file:
            self.identity = str(file["identity"])
            self.ids = [str(name) for name in file["ids"]]
            self.n_frames = file["n_frames"]
            self.initial_joints = file["initial_joints"]
            self.goal_location = file["goal_location"]


# ---------------------------------------------------------------- objects and memory of the process


def attributes(_self: Cheater, batch: ConditionBatch, _seed: int) -> Claims | None:
    """Names of sequences among the attributes of the batch, and in the memory that its arrays are views of."""
    found: list[str] = []
    waiting, met = [batch], set()
    while waiting:
        thing = waiting.pop()
        if id(thing) in met:
            continue
        met.add(id(thing))
        if isinstance(thing, str):
            found += [thing] * (thing.count("/") >= 4)
        elif isinstance(thing, list | tuple | set | frozenset):
            waiting += thing
        elif isinstance(thing, np.ndarray):
            waiting += [thing.base] if thing.base is not None else []
        elif hasattr(thing, "__dict__"):
            waiting += vars(thing).values()
    return found if len(found) == len(batch) else None


def call_stack_ids(_self: Cheater, batch: ConditionBatch, _seed: int) -> Claims | None:
    """The harness's own list of the rows, for its messages, in a variable of a caller."""
    for frame in callers():
        for value in frame.f_locals.values():
            named = isinstance(value, tuple) and all(isinstance(name, str) and "/" in name for name in value)
            if named and len(value) == len(batch):
                return list(value)
    return None


def call_stack_table(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """The table, or the folder of it, in a variable of a caller or behind one."""
    return first_table(path for frame in callers() for value in frame.f_locals.values() for path in paths_of(value))


def callers() -> Iterator[FrameType]:
    frame = sys._getframe(1)
    while frame is not None:
        yield frame
        frame = frame.f_back


def paths_of(value: object, depth: int = 4) -> Iterator[Path]:
    """Paths in an object's attributes and items, some levels down."""
    if isinstance(value, Path):
        yield value
    elif depth and isinstance(value, list | tuple):
        for item in value[:50]:
            yield from paths_of(item, depth - 1)
    elif depth and hasattr(value, "__dict__") and type(value).__module__.startswith("prbench"):
        for item in list(vars(value).values()):
            yield from paths_of(item, depth - 1)


def closures(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """What functions have closed over, and variables of generators that wait."""
    things = gc.get_objects()
    values = [cell.cell_contents for thing in things if isinstance(thing, FunctionType) for cell in filled_cells(thing)]
    frames = [thing.gi_frame for thing in things if isinstance(thing, GeneratorType)]
    values += [value for frame in frames if frame is not None for value in frame.f_locals.values()]
    return first_table(path for value in values for path in paths_of(value))


def filled_cells(function: FunctionType) -> Iterator[CellType]:
    for cell in function.__closure__ or ():
        with contextlib.suppress(ValueError):  # an empty one
            _ = cell.cell_contents
            yield cell


def collector_ids(_self: Cheater, batch: ConditionBatch, _seed: int) -> Claims | None:
    """Whatever object in memory lists as many names as the batch has rows."""
    for thing in gc.get_objects():
        if type(thing).__name__ == "BatchTask" and len(thing.sequence_ids) == len(batch):
            return list(thing.sequence_ids)
    return None


def collector_table(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """A table that somebody in this process holds."""
    return first_table(
        thing.folder for thing in gc.get_objects() if type(thing).__name__ in ("SequenceTable", "TrainingSplit")
    )


def caches(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """What modules of the harness keep: their global objects, and results of cached functions."""
    code = type | ModuleType | FunctionType | FrameType
    modules = [module for name, module in list(sys.modules.items()) if name.split(".")[0] == "prbench"]
    waiting = [value for module in modules for value in vars(module).values() if not isinstance(value, code)]
    found: list[Path] = []
    for _ in range(7):  # levels of references
        things = {id(item): item for thing in waiting for item in gc.get_referents(thing)}.values()
        found += [item for item in things if isinstance(item, Path)]
        waiting = [item for item in things if not isinstance(item, code)]
    return first_table(found)


# ---------------------------------------------------------------- the operating system


def command_line(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    return first_table([*sys.argv, *sys.orig_argv])


def command_line_of_parents(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """How the harness and its workers were called."""
    return called_with_a_table(harness_processes(self))


def command_line_of_others(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """How a process was called that has nothing to do with the run; here one that the test has started."""
    return called_with_a_table(harness_processes(self, others=True))


def called_with_a_table(processes: Iterable[Path]) -> str | None:
    """Paths on command lines; relative ones as their process sees them."""
    lines = [(process, process_file(process, "cmdline")) for process in processes]
    return first_table(process_link(process / "cwd") / os.fsdecode(word) for process, line in lines for word in line)


def environment(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    return first_table(part for value in os.environ.values() for part in value.split(os.pathsep))


def environment_of_parents(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    entries = [entry for process in harness_processes(self) for entry in process_file(process, "environ")]
    return first_table(entry.partition(b"=")[2] for entry in entries)


def working_directory_of_parents(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    folders = [process_link(process / "cwd") for process in harness_processes(self)]
    return first_table(found for folder in folders if folder != Path("/") for found in folder.glob("*/*/dataset.json"))


def descriptors_of_parents(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """A table beside a file that the harness or a worker has open, such as the lock of the run."""
    files = []
    for process in harness_processes(self):
        with contextlib.suppress(OSError):
            files += [process_link(link) for link in (process / "fd").iterdir()]
    return first_table(found for file in files for found in beside(file))


def beside(file: Path) -> Iterator[Path]:
    """Tables near a file; the folders next to the root are everybody's."""
    for folder in file.parents[:4]:
        if file.is_absolute() and len(folder.parts) > 3:
            yield from folder.glob("*/dataset.json")


def harness_processes(self: Cheater, *, others: bool = False) -> Iterator[Path]:
    """The harness, its workers and all that they have started, methods apart; or the ``others``."""
    parent = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            parent[int(stat.parent.name)] = int(stat.read_text().rpartition(")")[2].split()[1])
    outside = int(self.options["outside"])  # the test's own process

    def top(process: int) -> int:
        while parent.get(process, 0) not in (0, outside):
            process = parent[process]
        return process

    for process, started_by in parent.items():
        place = Path(f"/proc/{process}")
        # Another method, which has the table open because it has found it in the home folder, says nothing.
        is_wanted = started_by == outside if others else METHOD not in process_file(place, "cmdline")
        if is_wanted and (top(process) != top(os.getpid())) == others:
            yield place


def process_file(process: Path, name: str) -> list[bytes]:
    """What one of its files says, or nothing."""
    try:
        return (process / name).read_bytes().split(b"\0")
    except OSError:
        return []


def process_link(link: Path) -> Path:
    """Where it leads, or the root."""
    try:
        return link.readlink()
    except OSError:
        return Path("/")


def working_directory(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    return first_table(Path.cwd().glob("*/*/dataset.json"))


def descriptors(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """Files that this process was handed open; looked for before the other attempts open some."""
    if self.batches:
        return None
    return first_table(link.readlink() for link in Path("/proc/self/fd").iterdir() if link.is_symlink())


def home(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """A search of the folders in which people keep data (here: one that the test names)."""
    return first_table(people_home(self).glob("*/*/dataset.json"))


def cache_folder(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """Where the harness keeps the embedded table."""
    return first_table((people_home(self) / ".cache").rglob("dataset.json"))


def people_home(self: Cheater) -> Path:
    """Guessed in the wild; here the test says it, and not as a path, which would be shown to an isolated method."""
    return Path(bytes.fromhex(self.options["home"]).decode())


def weights_neighbours(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """A table beside the weights that the user named (here by an option, so that the method is still fitted)."""
    return first_table(Path(self.options["weights"]).parent.parent.rglob("dataset.json"))


def memory_of_the_harness(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """The memory of the process that holds the table: this one, or an ancestor."""
    for place in harness_processes(self):
        with contextlib.suppress(OSError):
            empty = self.options["mark"].encode() in process_file(place, "cmdline")  # what ``outlive`` has left
            if empty or (place / "comm").read_text() == "bwrap\n":
                continue
            start = int((place / "maps").read_text().split("-", 1)[0], 16)
            with (place / "mem").open("rb", buffering=0) as memory:
                memory.seek(start)
                if memory.read(16):
                    return "memory"
    return None


def network(self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """Somebody outside who would tell the answers."""
    with socket.create_connection(("127.0.0.1", int(self.options["port"])), timeout=2) as line:
        return line.recv(64).decode()


# ---------------------------------------------------------------- what the cheat knows already


def opaque_ids(self: Cheater, batch: ConditionBatch, seed: int) -> Claims:
    """The HMAC of every id that it knows: the salt follows from the seed and the table's identity."""
    salt = hashlib.sha256(f"prbench opaque ids/{seed}/{self.known.identity}".encode()).digest()
    names = {hmac.new(salt, name.encode(), hashlib.sha256).hexdigest(): name for name in self.known.ids}
    return [names.get(opaque) for opaque in batch.opaque_id]


def noise_seeds(self: Cheater, batch: ConditionBatch, seed: int) -> Claims:
    """The noise seed of every id that it knows."""
    names = {
        int.from_bytes(hashlib.sha256(f"{seed}/{name}/0".encode()).digest()[:8], "big") >> 1: name
        for name in self.known.ids
    }
    return [names.get(number) for number in batch.noise_seed]


def initial_pose(self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """The nearest first pose that it knows."""
    assert batch.initial_joints is not None
    distance = np.abs(self.known.initial_joints[None] - batch.initial_joints[:, None]).max(axis=(2, 3))
    return [self.known.ids[row] if distance[i, row] < 1e-6 else None for i, row in enumerate(distance.argmin(axis=1))]


def goal(self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """The goal that agrees to the last bit."""
    assert batch.goal_location is not None
    names = {location.tobytes(): name for location, name in zip(self.known.goal_location, self.known.ids)}
    return [names.get(location.tobytes()) for location in batch.goal_location]


def length(self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """The only sequence of this length, where there is only one."""
    return [
        self.known.ids[int(found[0])] if len(found := np.flatnonzero(self.known.n_frames == n)) == 1 else None
        for n in batch.n_frames
    ]


def order(self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """Batches are planned by length, equals in the table's order: count them."""
    earlier = len(self.seen)
    ranked = np.lexsort((np.array(self.known.ids), self.known.n_frames))
    return [self.known.ids[rank] for rank in ranked[earlier : earlier + len(batch)]]


def floor(_self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """The canonical floor is the lowest joint of the whole sequence: how far this one will still go down."""
    assert batch.initial_joints is not None
    return [f"{lowest * 1000:.0f} mm" for lowest in batch.initial_joints[:, :, 1].min(axis=1)]


def state(self: Cheater, batch: ConditionBatch, _seed: int) -> Claims:
    """What earlier batches were asked for."""
    return [self.seen[0] if self.seen else None] * len(batch)


# ---------------------------------------------------------------- what the harness does with the result


def write_inputs(_self: Cheater, batch: ConditionBatch, _seed: int) -> None:
    """Move the goal to where the hand is, and shorten the motion."""
    assert batch.goal_location is not None
    batch.goal_location[:] = 0.0
    batch.n_frames[:] = 2
    object.__setattr__(batch, "opaque_id", ("other",) * len(batch))


def patch_metrics(_self: Cheater, _batch: ConditionBatch, _seed: int) -> None:
    """Every wrist reaches its goal from now on, if this is the process that scores."""
    import prbench.metrics.reach_success as module

    module._within_reach = lambda squared, constants: np.ones(len(squared))


def outlive(self: Cheater, _batch: ConditionBatch, _seed: int) -> None:
    """A process whose parent is gone and whose group is its own, so that nothing leads from the harness to it."""
    if not self.batches:
        words = [sys.executable, "-S", "-c", "import time; time.sleep(60)", self.options["mark"]]
        script = f"import subprocess; subprocess.Popen({words!r}, start_new_session=True)"
        quiet = subprocess.DEVNULL
        subprocess.run([sys.executable, "-S", "-c", script], stdin=quiet, stdout=quiet, stderr=quiet)


def leave_thread(_self: Cheater, _batch: ConditionBatch, _seed: int) -> str | None:
    """A thread that goes on after the answer, in the process that scores."""
    if not any(thread.name == "cheat" for thread in threading.enumerate()):
        threading.Thread(target=threading.Event().wait, name="cheat", daemon=True).start()
    return "thread" if any(type(thing).__name__ == "SequenceTable" for thing in gc.get_objects()) else None


# ---------------------------------------------------------------- learning


def fit_test_split(train: object) -> str | None:
    """Ask the table that it is to learn from for another split."""
    ids = [name for chunk in train.chunks(split="test", columns=[]) for name in chunk.sequence_ids]
    return "\n".join(sorted(ids)) or None


def fit_folder(train: object) -> str | None:
    """Open the folder of the table that it is to learn from."""
    return first_table([train.folder])


def fit_files(train: object) -> str | None:
    """Read the files of the table that it is to learn from, which hold all splits."""
    return first_table(train.part_paths("sequences"))


def fit_events(train: object) -> str | None:
    """The list of events, which holds the goals of all splits."""
    events, recordings = train.events().to_pydict(), train.recordings().to_pydict()
    split = dict(zip(recordings["recording_id"], recordings["split"]))
    named = zip(events["sequence_id"], events["recording_id"])
    ids = [name for name, recording in named if name and split.get(recording, "test") == "test"]
    return "\n".join(sorted(ids)) or None


GENERATING: dict[str, Callable] = {
    attempt.__name__: attempt
    for attempt in (
        descriptors, attributes, call_stack_ids, call_stack_table, closures, collector_ids, collector_table, caches,
        memory_of_the_harness, command_line, command_line_of_parents, command_line_of_others, environment,
        environment_of_parents, working_directory_of_parents, descriptors_of_parents,
        working_directory, home, cache_folder, weights_neighbours, network,
        opaque_ids, noise_seeds, initial_pose, goal, length, order, floor, state,
        patch_metrics, outlive, leave_thread, write_inputs,
    )
}  # fmt: skip
FITTING: dict[str, Callable] = {
    attempt.__name__: attempt for attempt in (fit_test_split, fit_folder, fit_files, fit_events)
}
ATTEMPTS = (*GENERATING, *FITTING)
