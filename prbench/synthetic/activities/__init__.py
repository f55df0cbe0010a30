"""Everyday activities of procedural people, with true descriptions: what pre-training corpora are invented from.

Source: docs/specification/synthetic-recordings.md#text.
"""

from prbench.synthetic.activities.narrated import NarratedMotion, TrueNarration
from prbench.synthetic.activities.recordings import Cast, cast_of, narrated_recording

__all__ = ["Cast", "NarratedMotion", "TrueNarration", "cast_of", "narrated_recording"]
