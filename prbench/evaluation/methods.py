"""A method as a run needs it: named, versioned, loaded once a process, fitted once a table."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from prbench.contract import Adapter, Condition, Trainable, TrainingRun
from prbench.errors import AdapterError, UsageError
from prbench.evaluation.adapters import InstalledAdapter, find_adapter, load_adapter
from prbench.evaluation.cache import cache_folder
from prbench.evaluation.controls import METHOD_CONTROLS
from prbench.evaluation.training_split import TrainingSplit
from prbench.sequences import SequenceTable
from prbench.storage import file_digest, text_digest

_FIT_SEED = 0  # of baselines that a run fits by itself; the run's own seed varies what is generated, not what is learnt


@dataclass
class LoadedMethod:
    """A method in this process."""

    adapter: Adapter
    warmed_up: bool = False
    """It has generated a batch, and with it loaded whatever loads on first use."""


@dataclass(frozen=True)
class MethodSpec:
    """Enough to make a method in any process."""

    name: str
    weights: Path | None
    options: tuple[tuple[str, str], ...]
    device: str
    threads: int
    fit_folder: Path | None = None
    """Where a fit is kept, if the method is fitted by the run."""
    table_folder: Path | None = None
    """The dataset that it is fitted to."""

    def load(self) -> LoadedMethod:
        """The method, ready to generate; made once a process."""
        return _load(self)

    def fitted_to(self, table: SequenceTable, installed: InstalledAdapter) -> MethodSpec:
        """The same method, fitted to a table if it learns and brought no weights of its own.

        Fits are kept in the cache folder by method, version, options and both digests of the table; the method itself
        finds there what an earlier fit has left.
        """
        if self.weights is not None or not isinstance(self.load().adapter, Trainable):
            return self
        key = text_digest(
            installed.package,
            installed.version,
            installed.target,
            *(part for option in self.options for part in option),
            table.identity,
            table.content,
        )
        return replace(self, fit_folder=cache_folder() / "fits" / f"{self.name}-{key[:16]}", table_folder=table.folder)


def method_spec(
    method: str,
    *,
    weights: Path | None = None,
    options: Mapping[str, str] | None = None,
    device: str = "cpu",
    threads: int = 1,
    isolate: bool = False,
    timeout: float | None = None,
    hidden: tuple[Path, ...] = (),
) -> MethodSpec:
    """How to make a method, whatever it is written in.

    Args:
        method: Name of an installed adapter, ``cmd:`` and a command, or path of a TOML file that describes a program.
        weights: File or folder, or the name of weights that the method knows; None for its default.
        options: ``--option key=value``, handed on as they are.
        device: ``cpu``, ``cuda`` …
        threads: Of the method.
        isolate: Run an installed method in a process of its own that is given neither paths, objects nor environment.
        timeout: Seconds until a batch is answered by another process.
        hidden: Folders that an isolated method must not see, where the file system can be withheld.

    Raises:
        AdapterError: if there is no such method, with the nearest one.
        InputFileError: if the TOML file does not say what it must.
        UsageError: if the settings do not fit together.
    """
    find_adapter(method, also_known=METHOD_CONTROLS)
    return MethodSpec(method, weights, tuple(sorted((options or {}).items())), device, threads)


@lru_cache(maxsize=1)
def _load(spec: MethodSpec) -> LoadedMethod:
    adapter = load_adapter(spec.name, spec.weights, dict(spec.options), spec.device)
    if spec.fit_folder is not None and spec.table_folder is not None and isinstance(adapter, Trainable):
        run = TrainingRun(folder=spec.fit_folder, seed=_FIT_SEED, device=spec.device)
        adapter.fit(TrainingSplit.open(spec.table_folder), validation=None, run=run)
    return LoadedMethod(adapter)


def forget_loaded_methods() -> None:
    """Load afresh what is asked for next; a new run never meets the state that an earlier one left in a method."""
    _load.cache_clear()


def used_weights(adapter: Adapter, condition: Condition, given: Path | None, *, origin: str) -> Path | None:
    """The weights that a method uses under a condition: those it names itself (``weights_for``), else those given.

    Raises:
        AdapterError: if it names something that is no path.
    """
    weights_for = getattr(adapter, "weights_for", None)
    if weights_for is None:
        return given
    weights = weights_for(condition)
    if weights is None or isinstance(weights, Path):
        return weights
    raise AdapterError(f"{origin}: expected weights_for() to return a pathlib.Path or None, found {weights!r}.")


def require_weights(weights: Path | None) -> None:
    """Refuse a path that does not exist; a single word may be a name that the method knows.

    Raises:
        UsageError: if it is neither.
    """
    if weights is not None and not weights.exists() and (len(weights.parts) > 1 or weights.suffix):
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")


def weights_digest(weights: Path | None) -> str | None:
    """SHA-256 of a weights file, or of the names and contents of a folder.

    Raises:
        UsageError: if the path does not exist.
    """
    if weights is None:
        return None
    if weights.is_file():
        return file_digest(weights)
    if not weights.is_dir():
        raise UsageError(f"--weights {weights}: expected a file or folder, found neither.")
    total = hashlib.sha256()
    for path in sorted(path for path in weights.rglob("*") if path.is_file()):
        total.update(f"{path.relative_to(weights).as_posix()}\t{file_digest(path)}\n".encode())
    return total.hexdigest()
