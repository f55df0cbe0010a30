"""Curation: from recordings to a table of prime-and-reach sequences."""

from prbench.curation.build import BuildReport, Progress, build_dataset, build_from_sources
from prbench.curation.curate import CuratedRecording, curate_recording
from prbench.curation.funnel import FunnelRow, funnel_rows
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.curation.plan import BuildPlan, plan_build
from prbench.curation.sources import RecordingSource

__all__ = [
    "BuildOptions",
    "BuildPlan",
    "BuildReport",
    "CuratedRecording",
    "CurationOptions",
    "FunnelRow",
    "Progress",
    "RecordingSource",
    "build_dataset",
    "build_from_sources",
    "curate_recording",
    "funnel_rows",
    "plan_build",
]
