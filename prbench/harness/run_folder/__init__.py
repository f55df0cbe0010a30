"""The run folder: what a run is, its predictions, scores, summary and cost on disk."""

from prbench.harness.run_folder.folder import DatasetFolder, RunFolder, run_folder_of
from prbench.harness.run_folder.predictions import PredictionRows, Predictions
from prbench.harness.run_folder.record import CONTROL, MethodRecord, RunCost, RunRecord, TableRecord
from prbench.harness.run_folder.scores import SCORES, CodedScores, long_form, read_scores
from prbench.harness.run_folder.summary import DatasetAgreement, DatasetSummary, MetricSummary
