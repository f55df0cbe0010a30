"""What an evaluator is: the sizes of its networks, and how it reads motions and texts."""

from __future__ import annotations

from typing import Literal

import msgspec

from prbench.representation import N_FEATURES, Mode
from prbench.representation.features import FOOT_CONTACTS

MOVEMENT_FEATURES = FOOT_CONTACTS.start
"""Of the 263 features, the 259 that the movement encoder sees: all but the contacts."""
SNIPPET = 4
"""Frames that become one snippet."""
GLOVE = "glove"
assert N_FEATURES - MOVEMENT_FEATURES == 4


class EvaluatorConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Defaults are those of the text-to-motion paper.

    Source: docs/specification/text-to-motion-eval.md#training-the-extractor.
    """

    movement_width: int = 512
    """Channels of the movement encoder, and numbers of a snippet."""
    motion_width: int = 1024
    """Of the motion encoder's GRU, in each direction."""
    text_width: int = 512
    """Of the text encoder's GRU, in each direction."""
    embedding: int = 512
    """Dimension of the space that both encoders map into."""
    text: Literal["glove", "hashed-ngrams", "distilbert"] = "glove"
    """Whose word vectors the text encoder reads. Numbers of different ones never stand in one column."""
    most_tokens: int = 64
    """Later tokens of a text are dropped. GloVe's captions are cut to 20 words whatever stands here."""
    representation: Mode = "continuous"
    fps: float = 20.0
    max_frames: int = 196
    """Longer motions are cropped to this before they are embedded."""

    def __post_init__(self) -> None:
        for name in ("movement_width", "motion_width", "text_width", "embedding", "most_tokens"):
            if getattr(self, name) < 1:
                raise ValueError(f"`{name}` must be 1 or more")
        if self.max_frames < SNIPPET:
            raise ValueError(f"`max_frames` must be {SNIPPET} or more")
