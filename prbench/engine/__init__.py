"""Map a function over work items: in process, in a pool of processes or on a cluster, in order, with the same results.

An engine is anything with :meth:`Engine.map`; builds, runs and scoring take one as an argument. Ray is one more
(:mod:`prbench.engine.on_ray`), imported when it is asked for.
"""

from prbench.engine.pool import Engine, Full, InProcess, ProcessPool, answer, call, end_with_parent, is_out_of_memory

IN_PROCESS = InProcess()


def capacity(engine: Engine) -> int:
    """Items that an engine works on at a time."""
    count = getattr(engine, "capacity", None)  # of a cluster, which has to be asked
    return count() if count is not None else getattr(engine, "workers", 1)


def close_engine(engine: Engine) -> None:
    """Let an engine end what it keeps from one piece of work to the next: workers, and a connection to a cluster."""
    close = getattr(engine, "close", None)
    if close is not None:
        close()


def engine_for(workers: int) -> Engine:
    """``InProcess`` for one worker or none, else a ``ProcessPool``."""
    return InProcess() if workers <= 1 else ProcessPool(workers)
