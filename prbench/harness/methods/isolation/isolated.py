"""The programs of isolated methods: prbench's own worker for an installed one, or the user's program behind a fence."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from prbench.errors import UsageError
from prbench.harness.methods.isolation.bubblewrap import BUBBLEWRAP, HOME, Shown, available_fence, bubblewrap_words
from prbench.harness.methods.isolation.environment import (
    executable_folders,
    import_path,
    isolated_environment,
    python_folders,
    readable_folders,
    text_encoder,
)
from prbench.harness.methods.remote.process import Program
from prbench.harness.methods.users_environment import users_environment

_FIT_TIMEOUT = 7 * 24 * 3600.0  # seconds: fitting takes as long as it takes, as it does in this process
_WORKER = "prbench.harness.methods.worker"


@dataclass(frozen=True)
class Fit:
    """Folders of a fit: training rows, and the result."""

    train: Path
    """Folder of a copy of the training rows."""
    folder: Path


def worker_program(
    name: str,
    target: str,
    *,
    weights: Path | None,
    options: Iterable[tuple[str, str]],
    hidden: tuple[Path, ...],
    fit: Fit | None = None,
    timeout: float | None = None,
    benchmark: str,
) -> Program:
    """Return the worker that runs an installed method at a distance.

    Args:
        name: Name of the method.
        target: ``module:callable`` of its entry point.
        weights: A file or folder, or a name that the method knows.
        options: For the method; files that their values name by absolute paths are shown to it.
        hidden: Folders to withhold where that is possible.
        fit: For a method that is fitted by the run.
        timeout: Seconds for a batch.
        benchmark: Name of its benchmark.
    """
    environment = isolated_environment(users_environment()) | text_encoder(os.environ)
    # The worker finds prbench where this process found it, installed or not; it drops the variable again.
    environment["PYTHONPATH"] = os.pathsep.join(import_path())
    words = [sys.executable, "-P", "-m", _WORKER, name, "--benchmark", benchmark]
    shown = [Shown(path) for path in (*python_folders(target), *readable_folders(environment))]
    shown += [Shown(Path(value)) for _, value in options if Path(value).is_absolute()]
    if weights is not None:
        shown.append(Shown(weights.absolute(), essential=True))
    program = Program(name, (), None, tuple(sorted(environment.items())))
    if timeout is not None:
        program = replace(program, batch_timeout=timeout)
    if fit is not None:
        fit.folder.mkdir(parents=True, exist_ok=True)
        words += ["--train", str(fit.train), "--fit", str(fit.folder)]
        shown += [Shown(fit.train, essential=True), Shown(fit.folder, writable=True, essential=True)]
        program = replace(program, start_timeout=_FIT_TIMEOUT)
    return _behind_fence(replace(program, words=tuple(words)), shown, hidden)


def fenced(program: Program, *, readable: Iterable[Path], weights: Path | None, hidden: tuple[Path, ...]) -> Program:
    """Put a user's program behind the best fence that works here, its own folder read-only.

    Raises:
        UsageError: if its folder is one that has to be withheld.
    """
    environment = dict(program.environment)
    directory = program.directory
    if directory is not None and any(directory.resolve().is_relative_to(folder.resolve()) for folder in hidden):
        raise UsageError(f"--isolate: the program starts in {directory}, which is withheld. Start it elsewhere.")
    paths = [*readable, *executable_folders(Path(program.words[0])), *readable_folders(environment)]
    shown = [Shown(path) for path in dict.fromkeys(paths)]
    if weights is not None:
        shown.append(Shown(weights.absolute(), essential=True))
    return _behind_fence(program, shown, hidden)


def _behind_fence(program: Program, shown: Iterable[Shown], hidden: tuple[Path, ...]) -> Program:
    fence = available_fence()
    if fence.program is None:
        return replace(program, fence=fence.kind)
    before = bubblewrap_words(fence.program, shown=list(shown), hidden=hidden, directory=program.directory)
    environment = _inside(dict(program.environment))
    return replace(
        program, words=before + program.words, environment=tuple(sorted(environment.items())), fence=BUBBLEWRAP
    )


def _inside(environment: Mapping[str, str]) -> dict[str, str]:
    """Add the variables behind bubblewrap: an empty home, an empty temporary folder, no network to ask for models."""
    return {**environment, "HOME": HOME, "TMPDIR": "/tmp", "HF_HUB_OFFLINE": "1"}
