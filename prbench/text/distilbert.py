"""DistilBERT (base, uncased), the paper's text encoder, through transformers (docs/specification/mdm.md#network).

The vectors are the last hidden states of all word pieces, the two special ones included. Weights are read from
safetensors files only, and no code of a repository is run. Nothing is imported or loaded before the first text.
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

NAME = "distilbert"
HUB_ID = "distilbert/distilbert-base-uncased"
VARIABLE = "PRBENCH_DISTILBERT"
"""Environment variable: a local folder or a hub id."""
DIMENSION = 768
MOST_PIECES = 512
"""DistilBERT has no more positions; longer texts are cut."""
MOST_KEPT = 65536
"""Distinct texts whose vectors are kept in memory (about 35 kB each)."""


class DistilBert:
    """Frozen DistilBERT on the CPU in float32.

    Texts go through the network one by one and are kept, so that a vector depends on its text alone, to the last bit.

    Args:
        path: A local folder (``config.json``, ``model.safetensors``, ``tokenizer.json`` or ``vocab.txt``) or a hub
            id; by default what ``PRBENCH_DISTILBERT`` names, else the public model's id.

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
        """The vectors of all word pieces of each text (see :class:`prbench.text.TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are not DistilBERT base's.
        """
        return padded([self._vectors(text) for text in texts], DIMENSION)

    def _encode_one(self, text: str) -> Float[np.ndarray, "pieces 768"]:
        import torch

        tokenizer, model = self._loaded or self._load()
        pieces = tokenizer([text], truncation=True, max_length=MOST_PIECES, return_tensors="pt")
        with torch.inference_mode():
            states = model(input_ids=pieces["input_ids"], attention_mask=pieces["attention_mask"]).last_hidden_state
        return states[0].float().numpy()

    def _load(self) -> tuple[Any, Any]:
        careful = careful_loading(self.source)
        if careful is None:
            raise self._unusable("no such folder")
        from transformers import DistilBertModel, DistilBertTokenizerFast

        try:
            tokenizer = DistilBertTokenizerFast.from_pretrained(self.source, **careful)
            careful |= {"use_safetensors": True, "output_loading_info": True}
            loaded: Any = DistilBertModel.from_pretrained(self.source, **careful)
        except (OSError, ValueError, KeyError, RuntimeError) as error:
            raise self._unusable(f"none that can be loaded ({first_line(error)})") from error
        model, report = loaded
        if missing := sorted(report["missing_keys"]):  # they would be random numbers
            raise self._unusable(f"a model without '{missing[0]}'")
        if model.config.dim != DIMENSION:
            raise self._unusable(f"a model of dimension {model.config.dim}")
        self._loaded = tokenizer, model.eval().requires_grad_(False)
        return self._loaded

    def _unusable(self, found: str) -> InputFileError:
        return InputFileError(
            self.source,
            "",
            expected=f"DistilBERT base uncased (dimension {DIMENSION}) as safetensors",
            found=found,
            remedy=f"Download config.json, model.safetensors, tokenizer.json, tokenizer_config.json and vocab.txt of "
            f"'{HUB_ID}' on a machine with internet, put them into one folder, and name that folder with the "
            f"environment variable {VARIABLE} or the option for the text encoder's path.",
        )
