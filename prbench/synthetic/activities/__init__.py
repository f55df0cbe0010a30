"""Everyday activities of procedural people, with true descriptions: what pre-training corpora are invented from.

Source: ``methods/synthetic-recordings.md`` section 13.
"""

from prbench.synthetic.activities.narrated import NarratedMotion, TrueNarration
from prbench.synthetic.activities.recordings import Cast, cast_of, narrated_recording

__all__ = ["Cast", "NarratedMotion", "TrueNarration", "cast_of", "narrated_recording"]
