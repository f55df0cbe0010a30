"""Curation: from recordings to a table of prime-and-reach sequences."""

from prbench.curation.curate import CuratedRecording, curate_recording
from prbench.curation.options import BuildOptions, CurationOptions

__all__ = ["BuildOptions", "CuratedRecording", "CurationOptions", "curate_recording"]
