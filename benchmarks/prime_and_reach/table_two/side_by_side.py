"""Generate several runs at once: batches of one beside those of others, so that no worker waits for the last of a row.

Every batch is the one that the run would make by itself, in the place where the run will look for it.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterator, Mapping

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
_Named = tuple[str, BatchTask]


def generate_side_by_side(
    requests: Mapping[str, RunRequest], engine: Engine, *, counting: Counting, seconds: float = math.inf
) -> tuple[dict[str, str], str | None]:
    """Make what is missing of several runs; what goes wrong with one ends nothing but itself.

    Args:
        requests: By name, in the order in which they are begun.
        engine: Where batches are generated.
        counting: Called after every batch with the runs before its own, all of them, and its own name.
        seconds: After which no further run is begun.

    Returns:
        The reason for each run that lacks batches; and why the work ended early, if a worker was killed: nothing is
        known then of runs without batches.

    Raises:
        StorageError: if a file cannot be written.
    """
    until = time.monotonic() + seconds
    failed: dict[str, str] = {}
    begun: list[str] = []
    broken = None

    def tasks(held: contextlib.ExitStack) -> Iterator[_Named]:
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
                    yield name, task
            except StorageError:
                raise
            except Exception as error:
                failed.setdefault(name, why(error))

    try:
        with contextlib.ExitStack() as held:  # until the last batch is made
            for name, reason in engine.map(_try, tasks(held), if_full=lambda named, error: (named[0], str(error))):
                if reason is not None:
                    failed.setdefault(name, reason)
                counting(begun.index(name), len(requests), name)
            counting(len(begun), len(requests), "")
    except StorageError:
        raise
    except PrbenchError as error:
        broken = str(error)
    finally:
        forget_loaded_methods()
    for name in failed:
        # A failed first batch leaves nothing behind: an empty run folder would look like a run that can be resumed.
        out = requests[name].out
        if out is not None and (out / RECORD).is_file():
            RunFolder.open(out).discard_if_empty()
    return failed, broken


def _try(named: _Named) -> tuple[str, str | None]:
    """Make one batch, in a worker; return its run and the reason why it could not be made."""
    name, task = named
    try:
        run_batch(task)
    except StorageError:
        raise
    except Exception as error:  # a defect of a method, which must not cost the other rows
        if is_out_of_memory(error):
            raise  # the engine tries again when nothing else is done beside it
        return name, why(error)
    return name, None


def why(error: Exception) -> str:
    """Return the message for an error that ended a run."""
    return str(error) if isinstance(error, PrbenchError) else f"{type(error).__name__}: {error}"
