"""Arguments as people write them in a notebook: one value or several, text or paths, turned into one form."""

from __future__ import annotations

import contextlib
import functools
import inspect
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import numpy as np

from prbench.contract import Condition
from prbench.engine import Engine, close_engine
from prbench.engine.choice import Cluster, open_engine
from prbench.errors import PrbenchError, UsageError, did_you_mean
from prbench.object_stores.store import is_url

# A path as text or as a :class:`pathlib.Path`, ``~`` means the home folder; or a URL such as ``s3://bucket/folder`` as
# text (docs/object-stores.md).
PathLike = str | os.PathLike[str]
# Processes of this machine, or a cluster.
Workers = int | Cluster
# One text, or several.
Texts = str | Iterable[str]
_NOTE = "note: "


Given = ParamSpec("Given")
Result = TypeVar("Result")


def own_parameters(function: Callable[Given, Result]) -> Callable[Given, Result]:
    """Let a method name its own parameters: where it is called by others, and in messages that name options.

    Args:
        function: The method; it raises messages of the command line, such as ``name it with --data DIR``.
    """
    signature = inspect.signature(function)

    @functools.wraps(function)
    def called(*values: Given.args, **named: Given.kwargs) -> Result:
        try:
            signature.bind(*values, **named)
        except TypeError as error:
            known = ", ".join(list(signature.parameters)[1:])
            raise TypeError(f"{function.__name__}(): {error}; its parameters are: {known}") from None
        try:
            return function(*values, **named)
        except PrbenchError as error:
            error.args = (str(error).replace("--data DIR", "data=FOLDER").replace("with --data", "with data=FOLDER"),)
            raise

    return called


def as_path(value: PathLike) -> Path:
    """Return a path to something that is read; ``~`` is the home folder, as a shell has it.

    Args:
        value: Path as text or :class:`pathlib.Path`; or a URL as text, whose local copy is returned.

    Raises:
        InputFileError: if nothing finished lies at the URL.
        StorageError: if its store cannot be reached.
    """
    if is_url(value):
        from prbench.object_stores.inputs import fetched

        return fetched(str(value))
    return Path(value).expanduser()


@contextlib.contextmanager
def output_folder(value: PathLike) -> Iterator[Path]:
    """Yield a folder that the block writes; at a URL it is published when the block ends well.

    Args:
        value: Path or URL.

    Raises:
        StorageError: if the store of a URL cannot be reached, or another command writes there.
    """
    if is_url(value):
        from prbench.object_stores.outputs import written_folder

        def warn(line: str) -> None:  # where something went wrong; how much is fetched and uploaded is not told
            if line.startswith(_NOTE):
                warnings.warn(line.removeprefix(_NOTE), stacklevel=2)

        with written_folder(str(value), tell=warn) as (folder, _):
            yield folder
    else:
        yield Path(value).expanduser()


@contextlib.contextmanager
def optional_output_folder(value: PathLike | None) -> Iterator[Path | None]:
    """:func:`output_folder` of a value, or None for None.

    Args:
        value: Path or URL, or None.
    """
    if value is None:
        yield None
    else:
        with output_folder(value) as folder:
            yield folder


@contextlib.contextmanager
def output_file(value: PathLike) -> Iterator[Path]:
    """Yield a file that the block writes; at a URL it is uploaded when the block ends well.

    Args:
        value: Path or URL.

    Raises:
        StorageError: if the store of a URL cannot be reached.
    """
    if is_url(value):
        from prbench.object_stores.outputs import written_file

        with written_file(str(value)) as path:
            yield path
    else:
        yield Path(value).expanduser()


def as_optional_path(value: PathLike | None) -> Path | None:
    """Return :func:`as_path` of a value, or None for None.

    Args:
        value: Path as text or :class:`pathlib.Path`, or None.
    """
    return None if value is None else as_path(value)


def as_array(name: str, value: Any) -> np.ndarray:
    """Return numbers of any form as an array of floats.

    Args:
        name: Name of the argument, for the message.
        value: An array, a nested list, or a tensor on the processor.

    Raises:
        UsageError: if it holds no numbers.
    """
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name}: expected numbers, found {type(value).__name__} ({error}).") from error


def as_texts(value: Texts) -> tuple[str, ...]:
    """Return one text or several as a tuple.

    Args:
        value: A text, or texts.
    """
    return (value,) if isinstance(value, str) else tuple(value)


def as_options(value: Mapping[str, object] | None, *, name: str = "option") -> dict[str, str]:
    """Return options by name as text, which is what ``--option NAME=VALUE`` hands over.

    Args:
        value: Options by name; ``True`` and ``False`` become ``true`` and ``false``. None stands for no options.
        name: Name of the argument, for the message.

    Raises:
        UsageError: if it maps no names to values.
    """
    if value is None:
        return {}
    if not isinstance(value, Mapping):
        raise UsageError(f"{name}: expected a dict such as {{'name': 'value'}}, found {type(value).__name__}.")
    texts = {str(key): str(each) for key, each in value.items()}
    return texts | {str(key): str(each).lower() for key, each in value.items() if isinstance(each, bool)}


def as_condition(name: str) -> Condition:
    """Return a condition by its name.

    Args:
        name: ``none``, ``text``, ``goal-pose`` or ``goal-loc``.

    Raises:
        UsageError: for an unknown name, with the nearest known one.
    """
    known = [condition.value for condition in Condition]
    if name not in known:
        raise UsageError(f"unknown condition '{name}'; there are: {', '.join(known)}.{did_you_mean(name, known)}")
    return Condition(name)


def local(workers: Workers) -> int:
    """Return the number of processes for work that stays on this machine.

    Args:
        workers: Processes, or a cluster, as the public function was given them.

    Raises:
        UsageError: for anything but a number of processes or a cluster.
    """
    if isinstance(workers, Cluster):
        return 1
    if not isinstance(workers, int):
        raise UsageError(f"workers: expected a number of processes or a prbench.Cluster, found {workers!r}.")
    require_positive(workers=workers)
    return workers


@contextlib.contextmanager
def engine_of(workers: Workers, **needs: Any) -> Iterator[Engine]:
    """Open the engine that the block works with, and close it after the block.

    Args:
        workers: Processes, or a cluster, as the public function was given them.
        needs: What work on a cluster needs of every node: see :func:`prbench.engine.choice.open_engine`.

    Raises:
        UsageError: for anything but a number of processes or a cluster.
    """
    local(workers)
    engine = open_engine(workers, **needs, tell=lambda line: warnings.warn(line, stacklevel=2))
    try:
        yield engine
    finally:
        close_engine(engine)


def require_positive(**numbers: int | None) -> None:
    """Refuse counts below 1; None stands for "not given".

    Args:
        numbers: Values by the name of their argument.

    Raises:
        UsageError: naming the first wrong one.
    """
    for name, value in numbers.items():
        if value is not None and value < 1:
            raise UsageError(f"{name}: expected a whole number of at least 1, found '{value}'")
