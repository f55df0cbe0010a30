"""The run folder: what a run is, its predictions, scores, summary and cost on disk."""

from prbench.runs.cost import RunCost
from prbench.runs.folder import DatasetFolder, RunFolder
from prbench.runs.predictions import Predictions
from prbench.runs.record import RunRecord
from prbench.runs.scores import read_scores
from prbench.runs.summary import DatasetSummary, MetricSummary

__all__ = [
    "DatasetFolder",
    "DatasetSummary",
    "MetricSummary",
    "Predictions",
    "RunCost",
    "RunFolder",
    "RunRecord",
    "read_scores",
]
