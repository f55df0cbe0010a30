"""Generate several runs at once: batches of one beside those of others, so that no worker waits for the last of a row.

Every batch is the one that the run would make by itself, in the place where the run will look for it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from prbench.engine import Engine, is_out_of_memory
from prbench.errors import PrbenchError, StorageError
from prbench.files.storage import sole_writer
from prbench.harness.methods.loading import forget_loaded_methods
from prbench.harness.request import RunRequest
from prbench.harness.run import BatchTask, missing_batches, run_batch
from prbench.harness.run_folder.folder import RunFolder
from prbench.harness.run_folder.record import FILE_NAME as RECORD

Counting = Callable[[int, int, str], None]
"""Called with finished items, all items, and the next or last one's name."""


@dataclass(frozen=True)
class SideBySide:
    """The outcome of the runs whose batches were made."""

    failed: dict[str, str]
    """Maps the name of a run that lacks batches to the reason."""
    untouched: frozenset[str]
    """Runs that were not begun because time was up."""
    broken: str | None
    """The reason why the work ended early: a worker was killed. Nothing is known then of runs without batches."""


@dataclass(frozen=True)
class _NamedTask:
    name: str
    task: BatchTask


@dataclass(frozen=True)
class _Tried:
    name: str
    reason: str | None
    """The reason why it could not be made; None if it was."""


def generate_side_by_side(
    requests: Mapping[str, RunRequest], engine: Engine, *, counting: Counting, seconds: float = math.inf
) -> SideBySide:
    """Make what is missing of several runs; what goes wrong with one ends nothing but itself.

    Args:
        requests: By name, in the order in which they are begun.
        engine: Where batches are generated.
        counting: Called after every batch with the runs before its own, all of them, and its own name.
        seconds: After which no further run is begun.

    Raises:
        StorageError: if a file cannot be written.
    """
    until = time.monotonic() + seconds
    failed: dict[str, str] = {}
    begun: list[str] = []
    broken = None
    try:
        with contextlib.ExitStack() as held:  # until the last batch is made
            tasks = _tasks(requests, engine, begun, failed, until, held)
            for tried in engine.map(_try, tasks, if_full=lambda named, error: _Tried(named.name, str(error))):
                if tried.reason is not None:
                    failed.setdefault(tried.name, tried.reason)
                counting(begun.index(tried.name), len(requests), tried.name)
            counting(len(begun), len(requests), "")
    except StorageError:
        raise
    except PrbenchError as error:
        broken = str(error)
    finally:
        forget_loaded_methods()
    # An empty run folder would look like a run that can be resumed.
    for name in failed:
        # A failed first batch leaves nothing behind.
        out = requests[name].out
        if out is not None and (out / RECORD).is_file():
            RunFolder.open(out).discard_if_empty()
    return SideBySide(failed, frozenset(requests) - frozenset(begun), broken)


def _tasks(
    requests: Mapping[str, RunRequest],
    engine: Engine,
    begun: list[str],
    failed: dict[str, str],
    until: float,
    held: contextlib.ExitStack,
) -> Iterator[_NamedTask]:
    for name, request in requests.items():
        if time.monotonic() > until:
            return
        begun.append(name)
        try:
            if request.out is not None:
                held.enter_context(sole_writer(request.out))
            for task in missing_batches(request, engine=engine):
                # A method that failed once fails again; its other batches would only cost time.
                if name in failed:
                    break
                yield _NamedTask(name, task)
        except StorageError:
            raise
        except Exception as error:
            failed.setdefault(name, why(error))


def _try(named: _NamedTask) -> _Tried:
    """Make one batch, in a worker."""
    try:
        run_batch(named.task)
    except StorageError:
        raise
    except Exception as error:  # a defect of a method, which must not cost the other rows
        if is_out_of_memory(error):
            raise  # the engine tries again when nothing else is done beside it
        return _Tried(named.name, why(error))
    return _Tried(named.name, None)


def why(error: Exception) -> str:
    """Return the message for an error that ended a run."""
    return str(error) if isinstance(error, PrbenchError) else f"{type(error).__name__}: {error}"
