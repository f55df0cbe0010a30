"""Curation: from recordings to a table of prime-and-reach sequences."""

from prbench.curation.build import BuildPlan, BuildReport, build_dataset, build_from_sources, plan_build
from prbench.curation.curate import CuratedRecording, curate_recording
from prbench.curation.job import RecordingSource, funnel_rows
from prbench.curation.options import BuildOptions, CurationOptions
