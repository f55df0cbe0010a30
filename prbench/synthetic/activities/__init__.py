"""Everyday activities of procedural people, with true descriptions: the source of synthetic pre-training corpora.

Source: docs/specification/synthetic-recordings.md#text.
"""

from prbench.synthetic.activities.narrate import NarratedMotion, TrueNarration
from prbench.synthetic.activities.recordings import Identity, identity_of, narrated_recording

__all__ = ["Identity", "NarratedMotion", "TrueNarration", "identity_of", "narrated_recording"]
