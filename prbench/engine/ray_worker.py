"""The worker of :mod:`prbench.engine.on_ray`: one process on a node, which works on one item at a time."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from typing import Any, cast

from prbench.engine.cluster import Answered
from prbench.engine.pool import Full, answer
from prbench.errors import PrbenchError
from prbench.shown import quoted


class RayWorker:
    """Keeps the function of the last item, and with it what that function has loaded."""

    def __init__(self, folder: str, environment: dict[str, str]) -> None:
        # Not by Ray's runtime environments: for each of those every worker would be started anew.
        os.environ.update(environment)
        if os.path.isdir(folder):  # noqa: PTH112 - relative paths mean there what they mean here
            os.chdir(folder)
        self._packed = b""
        self._function: Callable[[Any], Any] | None = None

    def hello(self) -> int:
        """Answer as soon as the worker is ready, with its process id."""
        return os.getpid()

    def work(self, function: bytes, item: bytes) -> bytes:
        """Work on an item; packed here, so that Ray neither wraps errors nor keeps views of its store."""
        cloudpickle = importlib.import_module("ray.cloudpickle")

        outcome: Answered | Full
        try:
            if self._function is None or self._packed != function:
                self._packed, self._function = function, cloudpickle.loads(function)
            found = answer(cast(Callable, self._function), cloudpickle.loads(item))
            outcome = found if isinstance(found, Full) else Answered(found)
        except Exception as error:
            outcome = Answered(error=error)
        try:
            return cloudpickle.dumps(outcome)
        except Exception as error:
            what = (outcome.error if isinstance(outcome, Answered) else None) or error
            problem = PrbenchError(f"a result cannot leave its process: {type(what).__name__}: {quoted(what)}")
            return cloudpickle.dumps(Answered(error=problem))
