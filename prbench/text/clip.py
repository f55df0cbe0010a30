"""CLIP's text encoder (ViT-B/32), which MDM and GMD were released with, through transformers.

Source: docs/specification/mdm.md#network.

A text has **one** vector, so it is one token: the mean over its tokens is that vector. It is what OpenAI's
``encode_text`` gives: the state of the last layer at the end-of-text piece (the one with the highest id), after the
final normalisation, times the projection into the space of images; it is not scaled to unit length. Attention looks
back only, so the zeros behind that piece, which the original pads with, make no difference and are left away.

Weights are read from safetensors files only, and no code of a repository is run. Nothing is imported or loaded before
the first text.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError
from prbench.text.encoder import EncodedText, padded
from prbench.text.pretrained import careful_loading, first_line

NAME = "clip-vit-b32"
HUB_ID = "openai/clip-vit-base-patch32"
VARIABLE = "PRBENCH_CLIP"
"""Environment variable: a local folder or a hub id."""
DIMENSION = 512
MOST_PIECES = 20
"""Word pieces between the two special ones; MDM and GMD cut longer captions there."""
MOST_KEPT = 65536
"""Distinct texts whose vectors are kept in memory (2 kB each)."""
_OF_IMAGES = [r"vision_model\.", r"visual_projection\.", r"logit_scale", r"position_ids"]


class Clip:
    """Frozen text tower of CLIP ViT-B/32 on the CPU in float32; the originals compute it in half precision.

    Texts go through the network one by one and are kept, so that a vector depends on its text alone, to the last bit.
    Captions are taken as they are; the original also mends broken Unicode and HTML entities first.

    Args:
        path: A local folder (``config.json``, ``model.safetensors`` of the text tower or of all of CLIP, and
            ``tokenizer.json`` or ``vocab.json`` with ``merges.txt``) or a hub id; by default what ``PRBENCH_CLIP``
            names, else the public model's id.

    Raises:
        MissingExtraError: if transformers is not installed.
    """

    name = NAME
    dimension = DIMENSION

    def __init__(self, path: Path | str | None = None) -> None:
        if importlib.util.find_spec("transformers") is None:
            raise MissingExtraError("transformers", "text", f"the text encoder '{NAME}'")
        self.source = str(path or os.environ.get(VARIABLE) or HUB_ID)
        self._loaded: tuple[Any, Any] | None = None
        self._vectors = lru_cache(maxsize=MOST_KEPT)(self._encode_one)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """One vector a text, as its only token (see :class:`prbench.text.TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are not CLIP's.
        """
        return padded([self._vectors(text) for text in texts], DIMENSION)

    def _encode_one(self, text: str) -> Float[np.ndarray, "1 512"]:
        import torch

        tokenizer, model = self._loaded or self._load()
        pieces = tokenizer([text], truncation=True, max_length=MOST_PIECES + 2, return_tensors="pt")["input_ids"]
        with torch.inference_mode():
            states = model(input_ids=pieces).last_hidden_state[0]
            vector = model.text_projection(states[int(pieces[0].argmax())])
        return vector.float().numpy()[None]

    def _load(self) -> tuple[Any, Any]:
        careful = careful_loading(self.source)
        if careful is None:
            raise self._unusable("no such folder")
        from transformers import (
            CLIPTextModelWithProjection,
            CLIPTokenizerFast,  # pyright: ignore[reportAttributeAccessIssue] - an alias made late
        )

        class TextTower(CLIPTextModelWithProjection):
            """Silent about the parts of a whole CLIP that it does not need."""

            _keys_to_ignore_on_load_unexpected = _OF_IMAGES

        try:
            tokenizer = CLIPTokenizerFast.from_pretrained(self.source, **careful)
            careful |= {"use_safetensors": True, "output_loading_info": True}
            loaded: Any = TextTower.from_pretrained(self.source, **careful)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise self._unusable(f"none that can be loaded ({first_line(error)})") from error
        model, report = loaded
        self._require_whole(tokenizer, model, sorted(report["missing_keys"]))
        self._loaded = tokenizer, model.eval().requires_grad_(False)
        return self._loaded

    def _require_whole(self, tokenizer: Any, model: Any, missing: list[str]) -> None:
        """Refuse what would be made up: missing parameters become random numbers, a missing vocabulary an empty one."""
        if missing:
            raise self._unusable(f"a model without '{missing[0]}'")
        if model.config.projection_dim != DIMENSION:
            raise self._unusable(f"a model of dimension {model.config.projection_dim}")
        if len(tokenizer) != model.config.vocab_size:
            raise self._unusable(f"a vocabulary of {len(tokenizer)} pieces for a model of {model.config.vocab_size}")

    def _unusable(self, found: str) -> InputFileError:
        return InputFileError(
            self.source,
            "",
            expected=f"CLIP ViT-B/32 (text vectors of {DIMENSION} numbers) as safetensors",
            found=found,
            remedy="Save text tower and vocabulary into one folder on a machine with internet: "
            'python -c "from transformers import CLIPTextModelWithProjection as M, CLIPTokenizerFast as T; '
            f"[part.from_pretrained('{HUB_ID}').save_pretrained('clip-vit-b32') for part in (M, T)]\" "
            f"and name that folder with the environment variable {VARIABLE} or the option for the text encoder's path.",
        )
