"""The text encoders with weights of their own, through transformers: DistilBERT and CLIP's.

Source: docs/specification/mdm.md#network.

Weights are read from safetensors files only, and no code of a repository is run. Nothing is imported or loaded before
the first text. Texts go through a network one by one and their vectors are kept, so that a vector depends on its text
alone, to the last bit.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError
from prbench.text.built_in import EncodedText, padded

CLIP = "clip-vit-b32"
CLIP_VARIABLE = "PRBENCH_CLIP"
"""Environment variable: a local folder or a hub id."""
DISTILBERT = "distilbert"
DISTILBERT_VARIABLE = "PRBENCH_DISTILBERT"
"""Likewise."""
_CLIP_HUB_ID = "openai/clip-vit-base-patch32"
_DISTILBERT_HUB_ID = "distilbert/distilbert-base-uncased"
_MOST_KEPT = 65536
"""Distinct texts whose vectors are kept in memory (2 kB each of CLIP, about 35 kB each of DistilBERT)."""
_OF_IMAGES = [r"vision_model\.", r"visual_projection\.", r"logit_scale", r"position_ids"]
_HUB_ID = re.compile(r"[\w.-]+(/[\w.-]+)?")


class _Pretrained:
    """A frozen network on the CPU in float32.

    Args:
        path: A local folder or a hub id; by default what the environment variable names, else the public model's id.

    Raises:
        MissingExtraError: if transformers is not installed.
    """

    name: str
    dimension: int
    variable: str
    hub_id: str
    expected: str
    """Content of the files, as a message says it."""
    remedy: str

    def __init__(self, path: Path | str | None = None) -> None:
        if importlib.util.find_spec("transformers") is None:
            raise MissingExtraError("transformers", "text", f"the text encoder '{self.name}'")
        self.source = str(path or os.environ.get(self.variable) or self.hub_id)
        self._loaded: tuple[Any, Any] | None = None
        self._vectors = lru_cache(maxsize=_MOST_KEPT)(self._encode_one)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The token vectors of each text (see :class:`prbench.text.TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are those of another model.
        """
        return padded([self._vectors(text) for text in texts], self.dimension)

    def _encode_one(self, text: str) -> Float[np.ndarray, "tokens dimension"]:
        raise NotImplementedError

    def _classes(self) -> tuple[Any, Any]:
        """The classes of tokenizer and model in transformers."""
        raise NotImplementedError

    def _fault(self, tokenizer: Any, model: Any) -> str | None:
        """Say what makes loaded files those of another model; None if they fit."""
        raise NotImplementedError

    def _tokenizer_and_model(self) -> tuple[Any, Any]:
        if self._loaded is None:
            self._loaded = self._load()
        return self._loaded

    def _load(self) -> tuple[Any, Any]:
        """Run no code of a repository, and ask nobody else where a folder is given."""
        local = Path(self.source).is_dir()
        if not local and _HUB_ID.fullmatch(self.source) is None:
            raise self._unusable("no such folder")
        careful = {"trust_remote_code": False, "local_files_only": local}
        tokenizer_class, model_class = self._classes()
        try:
            tokenizer = tokenizer_class.from_pretrained(self.source, **careful)
            loaded = model_class.from_pretrained(self.source, **careful, use_safetensors=True, output_loading_info=True)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise self._unusable(f"none that can be loaded ({_first_line(error)})") from error
        model, report = loaded
        if missing := sorted(report["missing_keys"]):  # they would be random numbers
            raise self._unusable(f"a model without '{missing[0]}'")
        fault = self._fault(tokenizer, model)
        if fault is not None:
            raise self._unusable(fault)
        return tokenizer, model.eval().requires_grad_(False)

    def _unusable(self, found: str) -> InputFileError:
        return InputFileError(self.source, "", expected=self.expected, found=found, remedy=self.remedy)


class DistilBert(_Pretrained):
    """DistilBERT (base, uncased), the paper's text encoder: the last hidden states of all word pieces.

    The two special pieces are among them. A local folder has ``config.json``, ``model.safetensors``,
    ``tokenizer.json`` or ``vocab.txt``.
    """

    name = DISTILBERT
    dimension = 768
    variable = DISTILBERT_VARIABLE
    hub_id = _DISTILBERT_HUB_ID
    expected = f"DistilBERT base uncased (dimension {dimension}) as safetensors"
    remedy = (
        "Download config.json, model.safetensors, tokenizer.json, tokenizer_config.json and vocab.txt of"
        f" '{_DISTILBERT_HUB_ID}' on a machine with internet, put them into one folder, and name that folder with the"
        f" environment variable {DISTILBERT_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 512  # DistilBERT has no more positions; longer texts are cut

    def _encode_one(self, text: str) -> Float[np.ndarray, "pieces 768"]:
        import torch

        tokenizer, model = self._tokenizer_and_model()
        pieces = tokenizer([text], truncation=True, max_length=self._most_pieces, return_tensors="pt")
        with torch.inference_mode():
            states = model(input_ids=pieces["input_ids"], attention_mask=pieces["attention_mask"]).last_hidden_state
        return states[0].float().numpy()

    def _classes(self) -> tuple[Any, Any]:
        from transformers import DistilBertModel, DistilBertTokenizerFast

        return DistilBertTokenizerFast, DistilBertModel

    def _fault(self, tokenizer: Any, model: Any) -> str | None:  # noqa: ARG002 - any vocabulary fits
        return None if model.config.dim == self.dimension else f"a model of dimension {model.config.dim}"


class Clip(_Pretrained):
    """Text tower of CLIP ViT-B/32, which MDM and GMD were released with; they compute it in half precision.

    A text has **one** vector, so it is one token: the mean over its tokens is that vector. It is what OpenAI's
    ``encode_text`` gives: the state of the last layer at the end-of-text piece (the one with the highest id), after the
    final normalisation, times the projection into the space of images; it is not scaled to unit length. Attention looks
    back only, so the zeros behind that piece, which the original pads with, make no difference and are left away.
    Captions are taken as they are; the original also mends broken Unicode and HTML entities first.

    A local folder has ``config.json``, ``model.safetensors`` of the text tower or of all of CLIP, and
    ``tokenizer.json`` or ``vocab.json`` with ``merges.txt``.
    """

    name = CLIP
    dimension = 512
    variable = CLIP_VARIABLE
    hub_id = _CLIP_HUB_ID
    expected = f"CLIP ViT-B/32 (text vectors of {dimension} numbers) as safetensors"
    remedy = (
        "Save text tower and vocabulary into one folder on a machine with internet: "
        'python -c "from transformers import CLIPTextModelWithProjection as M, CLIPTokenizerFast as T; '
        f"[part.from_pretrained('{_CLIP_HUB_ID}').save_pretrained('clip-vit-b32') for part in (M, T)]\" "
        f"and name that folder with the environment variable {CLIP_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 20  # between the two special ones; MDM and GMD cut longer captions there

    def _encode_one(self, text: str) -> Float[np.ndarray, "1 512"]:
        import torch

        tokenizer, model = self._tokenizer_and_model()
        pieces = tokenizer([text], truncation=True, max_length=self._most_pieces + 2, return_tensors="pt")["input_ids"]
        with torch.inference_mode():
            states = model(input_ids=pieces).last_hidden_state[0]
            vector = model.text_projection(states[int(pieces[0].argmax())])
        return vector.float().numpy()[None]

    def _classes(self) -> tuple[Any, Any]:
        from transformers import (
            CLIPTextModelWithProjection,
            CLIPTokenizerFast,  # pyright: ignore[reportAttributeAccessIssue] - an alias made late
        )

        class TextTower(CLIPTextModelWithProjection):
            """Silent about the parts of a whole CLIP that it does not need."""

            _keys_to_ignore_on_load_unexpected = _OF_IMAGES

        return CLIPTokenizerFast, TextTower

    def _fault(self, tokenizer: Any, model: Any) -> str | None:
        """Refuse also a vocabulary that would be made up: transformers takes a missing one for an empty one."""
        if model.config.projection_dim != self.dimension:
            return f"a model of dimension {model.config.projection_dim}"
        if len(tokenizer) != model.config.vocab_size:
            return f"a vocabulary of {len(tokenizer)} pieces for a model of {model.config.vocab_size}"
        return None


def _first_line(error: BaseException) -> str:
    """Say what went wrong, short enough for a message."""
    return str(error).strip().partition("\n")[0].rstrip(".")[:300] or type(error).__name__
