"""The motions of a run, and what each of them scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
from jaxtyping import Float

from prbench.errors import PredictionsError, RunError
from prbench.runs import DatasetFolder, Predictions, RunFolder, RunRecord, read_scores


@dataclass(frozen=True, eq=False)
class RunMotions:
    """What one run made of one dataset."""

    label: str
    run: RunFolder
    dataset: str
    predictions: Predictions
    sample: int

    @classmethod
    def open(cls, run: RunFolder, dataset: str, *, label: str, sample: int = 0) -> RunMotions:
        """Open the predictions of a dataset.

        Raises:
            RunError: if the run has no predictions yet, is of other datasets, or drew fewer samples.
        """
        folder = run.dataset(dataset).predictions
        if not folder.is_dir() or not any(folder.glob("part-*.parquet")):
            raise RunError(
                f"{folder}: expected the predictions of a run, found none. Run the same `prbench run` again: it resumes"
                " where it was interrupted."
            )
        if not 0 <= sample < run.record.samples:
            raise RunError(f"{run.path}: expected a sample from 0 to {run.record.samples - 1}, found {sample}.")
        return cls(label, run, dataset, Predictions.open(folder), sample)

    @property
    def files(self) -> DatasetFolder:
        """Of the dataset."""
        return self.run.dataset(self.dataset)

    def __contains__(self, sequence_id: str) -> bool:
        return (sequence_id, self.sample) in self.predictions

    def joints(self, sequence_id: str, n_frames: int) -> Float[np.ndarray, "n 22 3"]:
        """The motion of a sequence, canonical frame, metres.

        Raises:
            PredictionsError: if it has another length than the recorded one, or holds NaN.
        """
        joints = self.predictions.motions([sequence_id], self.sample).values.astype(np.float64)
        if len(joints) != n_frames:
            raise PredictionsError(
                f"{self.files.predictions}, {sequence_id}: expected {n_frames} frames, found {len(joints)}."
            )
        if not np.isfinite(joints).all():
            raise PredictionsError(f"{self.files.predictions}, {sequence_id}: expected finite positions, found NaN.")
        return joints

    def scores(self, sequence_ids: Sequence[str]) -> Mapping[str, Mapping[str, float]]:
        """Metric values by sequence id; none for a run that was interrupted before it was scored.

        Raises:
            RunError: if the scores cannot be read.
        """
        found: dict[str, dict[str, float]] = {name: {} for name in sequence_ids}
        if not self.files.scores.is_file():
            return found
        table = read_scores(self.files.scores)
        table = table.filter((pc.field("sample") == self.sample) & pc.field("sequence_id").isin(list(sequence_ids)))
        names, metrics, values = (table[column].to_pylist() for column in ("sequence_id", "metric", "value"))
        for name, metric, value in zip(names, metrics, values, strict=True):
            found[name][metric] = value
        return found


def run_labels(paths: Sequence[Path], records: Sequence[RunRecord]) -> list[str]:
    """A short name for each run: method and condition, and the folder where two would read the same."""
    labels = []
    for record in records:
        control = f", {record.control}" if record.control else ""
        labels.append(f"{record.method.name}, {record.condition}{control}")
    return [
        f"{label} ({path.name})" if labels.count(label) > 1 else label
        for path, label in zip(paths, labels, strict=True)
    ]
