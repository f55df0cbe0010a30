"""Predictors that run elsewhere: observed windows out to a file, finished futures back in."""

from prbench_benchmarks.motion_prediction.offline.score import FuturesReport, FuturesRequest, score_futures
from prbench_benchmarks.motion_prediction.offline.windows_file import (
    WindowsExport,
    WindowsRequest,
    export_windows,
    read_windows,
)

__all__ = [
    "FuturesReport",
    "FuturesRequest",
    "WindowsExport",
    "WindowsRequest",
    "export_windows",
    "read_windows",
    "score_futures",
]
