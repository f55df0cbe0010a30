"""Text-to-motion metrics in the embedding space of a text–motion matching network (Prime and Reach, section F).

The metrics are NumPy; the networks (:mod:`.networks`, :mod:`.extractor`) import torch and are imported by whoever
needs them.
"""

from prbench.harness.text_to_motion.metrics import (
    FewSamplesWarning,
    Repeated,
    RPrecision,
    diversity,
    draw_diversity_pairs,
    draw_multimodality_pairs,
    fid,
    multimodal_distance,
    multimodality,
    r_precision,
)

__all__ = [
    "FewSamplesWarning",
    "RPrecision",
    "Repeated",
    "diversity",
    "draw_diversity_pairs",
    "draw_multimodality_pairs",
    "fid",
    "multimodal_distance",
    "multimodality",
    "r_precision",
]
