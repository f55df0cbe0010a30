"""Text encoders by name: captions to frozen token vectors.

torch and transformers are imported when a text is encoded.
"""

from __future__ import annotations

from pathlib import Path

from prbench.errors import UsageError, did_you_mean
from prbench.text import built_in
from prbench.text.built_in import EncodedText, TextEncoder
from prbench.text.pretrained import CLIP, DISTILBERT, Clip, DistilBert

__all__ = ["NAMES", "EncodedText", "TextEncoder", "text_encoder"]

NAMES = (built_in.NAME, DISTILBERT, CLIP)


def text_encoder(name: str, path: Path | str | None = None) -> TextEncoder:
    """The frozen text encoder of this name.

    Args:
        name: ``hashed-ngrams`` (built in), ``distilbert`` (the paper's; extra ``text``) or ``clip-vit-b32`` (one
            vector a text, for released weights of MDM and GMD; extra ``text``).
        path: For the last two: a local folder or a hub id; by default what ``PRBENCH_DISTILBERT`` or ``PRBENCH_CLIP``
            names, else the public id. Weights are loaded when the first text is encoded.

    Raises:
        UsageError: if there is no such encoder, or it has no files to be found under a path.
    """
    if name == built_in.NAME:
        if path is not None:
            raise UsageError(f"the text encoder '{name}' is built in and reads no files. Leave its path away.")
        return built_in.HashedNgrams()
    if name == DISTILBERT:
        return DistilBert(path)
    if name == CLIP:
        return Clip(path)
    hint = did_you_mean(name, NAMES)
    raise UsageError(f"there is no text encoder '{name}'.{hint} Known: {', '.join(NAMES)}.")
