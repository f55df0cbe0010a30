"""Motions on disk: a run's own parts, and what somebody hands in as Parquet or in NumPy's formats."""

from prbench.harness.run_folder.predictions.predictions import Predictions
from prbench.harness.run_folder.predictions.rows import PredictionRows, read_part, write_part

__all__ = ["PredictionRows", "Predictions", "read_part", "write_part"]
