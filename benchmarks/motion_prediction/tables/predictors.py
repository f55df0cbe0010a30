"""The predictor of a row: without learning, remembered from training windows, or an installed one with its weights."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Int

from prbench.errors import UsageError
from prbench.harness.benchmark import load_benchmark
from prbench.harness.methods.loading import load_adapter, require_weights
from prbench_benchmarks.motion_prediction.batch import Predictor
from prbench_benchmarks.motion_prediction.predictors import ConstantVelocity, NearestPast, ZeroVelocity
from prbench_benchmarks.motion_prediction.published_numbers import TableRow
from prbench_benchmarks.motion_prediction.table import WindowsTable

_WITHOUT_LEARNING = {each.name: each for each in (ZeroVelocity(), ConstantVelocity())}
_NEAREST_PAST = NearestPast.name


def predictor_of(
    row: TableRow, table: WindowsTable, train: Int[np.ndarray, " m"], weights: Path | None, *, device: str = "cpu"
) -> Predictor:
    """Find the predictor of a row.

    Args:
        row: What to run.
        table: The windows, from which the nearest past is learnt.
        train: Places of the windows that may be learnt from.
        weights: Folder with the user's weights by name, or a file or name of weights that is handed on; None for those
            that come with a predictor.
        device: Where a network runs.

    Raises:
        AdapterError: if it is not installed, or cannot be loaded.
        UsageError: if it needs training windows or weights that are not there.
    """
    if row.method in _WITHOUT_LEARNING:
        return _WITHOUT_LEARNING[row.method]
    if row.method == _NEAREST_PAST:
        if not len(train):
            raise UsageError(f"{row.method}: expected windows of a training split, found none in {table.folder}.")
        return NearestPast.fit(table.batches(row.condition, train))
    group = load_benchmark("motion-prediction").methods
    return load_adapter(row.method, weights_of(row, weights), {}, device, group=group)


def samples_of(predictor: Predictor, asked: int) -> int:
    """How many samples are asked for: one of a predictor that knows of no other, at most all that were remembered."""
    if predictor.name in _WITHOUT_LEARNING:
        return 1
    if isinstance(predictor, NearestPast):
        return min(asked, len(predictor.futures))
    return asked


def weights_of(row: TableRow, weights: Path | None) -> Path | None:
    """The weights file of a row; None for what comes with its predictor.

    Raises:
        UsageError: for an ablation without weights of its own, or a path that does not exist.
    """
    require_weights(weights)
    if weights is not None and not weights.is_dir():
        return weights
    for path in _places(row, weights):
        if path.is_file():
            return path
    if row.is_ablation:
        raise UsageError(f"no weights '{row.weights}': train them, and name their folder with --weights.")
    return None


def _places(row: TableRow, folder: Path | None) -> Iterator[Path]:
    if folder is not None:
        yield folder / f"{row.weights}.safetensors"
        yield folder / row.weights / "weights.safetensors"
