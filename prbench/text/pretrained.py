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
CLIP_VARIABLE = "PRBENCH_CLIP"  # Environment variable: a local folder or a hub id
DISTILBERT = "distilbert"
DISTILBERT_VARIABLE = "PRBENCH_DISTILBERT"  # Likewise
_CLIP_HUB_ID = "openai/clip-vit-base-patch32"
_DISTILBERT_HUB_ID = "distilbert/distilbert-base-uncased"
# Distinct texts whose vectors are kept in memory (2 kB each of CLIP, about 35 kB each of DistilBERT)
_MOST_KEPT = 65536
_OF_IMAGES = [r"vision_model\.", r"visual_projection\.", r"logit_scale", r"position_ids"]
_HUB_ID = re.compile(r"[\w.-]+(/[\w.-]+)?")


class _Pretrained:
    """A frozen network on the CPU in float32.

    Args:
        path: A local folder or a hub id; by default what the environment variable names, else the public model's id.

    Raises:
        MissingExtraError: if transformers is not installed.

    Attributes:
        _expected: Content of the files, as a message says it.
    """

    name: str
    dimension: int
    _variable: str
    _hub_id: str
    _expected: str
    _remedy: str
    _most_pieces: int

    def __init__(self, path: Path | str | None = None) -> None:
        if importlib.util.find_spec("transformers") is None:
            raise MissingExtraError("transformers", "text", f"the text encoder '{self.name}'")
        self.source = str(path or os.environ.get(self._variable) or self._hub_id)
        self._loaded: tuple[Any, Any] | None = None
        self._vectors = lru_cache(maxsize=_MOST_KEPT)(self._encode_one)

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The token vectors of each text (see :class:`prbench.text.TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are those of another model.
        """
        return padded([self._vectors(text) for text in texts], self.dimension)

    def _encode_one(self, text: str) -> Float[np.ndarray, "tokens dimension"]:
        import torch

        if self._loaded is None:
            self._loaded = self._load()
        tokenizer, model = self._loaded
        pieces = tokenizer([text], truncation=True, max_length=self._most_pieces, return_tensors="pt")
        with torch.inference_mode():
            return self._vectors_of(model, pieces).float().numpy()

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        raise NotImplementedError

    def _classes(self) -> tuple[Any, Any]:
        """The classes of tokenizer and model in transformers."""
        raise NotImplementedError

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
            why = str(error).strip().partition("\n")[0].rstrip(".")[:300] or type(error).__name__
            raise self._unusable(f"none that can be loaded ({why})") from error
        model, report = loaded
        if missing := sorted(report["missing_keys"]):  # they would be random numbers
            raise self._unusable(f"a model without '{missing[0]}'")
        dimension = getattr(model.config, "projection_dim", None) or model.config.dim
        if dimension != self.dimension:
            raise self._unusable(f"a model of dimension {dimension}")
        # A vocabulary may be made up: transformers takes a missing one for an empty one.
        if self.name == CLIP and len(tokenizer) != model.config.vocab_size:
            raise self._unusable(f"a vocabulary of {len(tokenizer)} pieces for a model of {model.config.vocab_size}")
        return tokenizer, model.eval().requires_grad_(False)

    def _unusable(self, found: str) -> InputFileError:
        return InputFileError(self.source, "", expected=self._expected, found=found, remedy=self._remedy)


class DistilBert(_Pretrained):
    """DistilBERT (base, uncased), the paper's text encoder: the last hidden states of all word pieces.

    The two special pieces are among them. A local folder has ``config.json``, ``model.safetensors``,
    ``tokenizer.json`` or ``vocab.txt``.
    """

    name = DISTILBERT
    dimension = 768
    _variable = DISTILBERT_VARIABLE
    _hub_id = _DISTILBERT_HUB_ID
    _expected = f"DistilBERT base uncased (dimension {dimension}) as safetensors"
    _remedy = (
        "Download config.json, model.safetensors, tokenizer.json, tokenizer_config.json and vocab.txt of"
        f" '{_DISTILBERT_HUB_ID}' on a machine with internet, put them into one folder, and name that folder with the"
        f" environment variable {DISTILBERT_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 512  # DistilBERT has no more positions; longer texts are cut

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        return model(input_ids=pieces["input_ids"], attention_mask=pieces["attention_mask"]).last_hidden_state[0]

    def _classes(self) -> tuple[Any, Any]:
        from transformers import DistilBertModel, DistilBertTokenizerFast

        return DistilBertTokenizerFast, DistilBertModel


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
    _variable = CLIP_VARIABLE
    _hub_id = _CLIP_HUB_ID
    _expected = f"CLIP ViT-B/32 (text vectors of {dimension} numbers) as safetensors"
    _remedy = (
        "Save text tower and vocabulary into one folder on a machine with internet: "
        'python -c "from transformers import CLIPTextModelWithProjection as M, CLIPTokenizerFast as T; '
        f"[part.from_pretrained('{_CLIP_HUB_ID}').save_pretrained('clip-vit-b32') for part in (M, T)]\" "
        f"and name that folder with the environment variable {CLIP_VARIABLE} or the option for the text encoder's path."
    )
    _most_pieces = 22  # the two special ones among them; MDM and GMD cut longer captions there

    def _vectors_of(self, model: Any, pieces: Any) -> Any:
        ids = pieces["input_ids"]
        states = model(input_ids=ids).last_hidden_state[0]
        return model.text_projection(states[int(ids[0].argmax())])[None]

    def _classes(self) -> tuple[Any, Any]:
        from transformers import (
            CLIPTextModelWithProjection,
            CLIPTokenizerFast,  # pyright: ignore[reportAttributeAccessIssue] - an alias made late
        )

        # Silent about the parts of a whole CLIP that it does not need.
        silent = {"_keys_to_ignore_on_load_unexpected": _OF_IMAGES}
        return CLIPTokenizerFast, type("TextTower", (CLIPTextModelWithProjection,), silent)
