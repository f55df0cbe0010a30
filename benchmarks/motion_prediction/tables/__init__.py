"""Tables 1, 2 and 3 of the study of motion prediction on any table of windows, and what gaze is worth."""

from prbench_benchmarks.motion_prediction.tables.layout import PredictionLayout
from prbench_benchmarks.motion_prediction.tables.run import TablesReport, TablesRequest, run_tables

__all__ = ["PredictionLayout", "TablesReport", "TablesRequest", "run_tables"]
