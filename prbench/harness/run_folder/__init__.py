"""The run folder: what a run is, its predictions, scores, summary and cost on disk."""

from prbench.harness.run_folder.folder import DatasetFolder, RunFolder
from prbench.harness.run_folder.predictions import Predictions
from prbench.harness.run_folder.record import RunCost, RunRecord
from prbench.harness.run_folder.scores import read_scores
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary
