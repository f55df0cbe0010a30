"""DistilBERT (base, uncased), the paper's text encoder, through transformers (``methods/mdm.md``).

The vectors are the last hidden states of all word pieces, the two special ones included. Weights are read from
safetensors files only, and no code of a repository is run. Nothing is imported or loaded before the first text.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError, MissingExtraError
from prbench.text.encoder import EncodedText, padded

NAME = "distilbert"
HUB_ID = "distilbert/distilbert-base-uncased"
VARIABLE = "PRBENCH_DISTILBERT"
"""Environment variable: a local folder or a hub id."""
DIMENSION = 768
MOST_PIECES = 512
"""DistilBERT has no more positions; longer texts are cut."""
BATCH = 64


class DistilBert:
    """Frozen DistilBERT on the CPU in float32; every distinct text is encoded once and kept.

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
        self._known: dict[str, Float[np.ndarray, "pieces 768"]] = {}

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The vectors of all word pieces of each text (see :class:`prbench.text.TextEncoder`).

        Raises:
            InputFileError: if the model's files cannot be found or are not DistilBERT base's.
        """
        missing = sorted({text for text in texts if text not in self._known}, key=len)
        for start in range(0, len(missing), BATCH):
            self._learn(missing[start : start + BATCH])
        return padded([self._known[text] for text in texts], DIMENSION)

    def _learn(self, texts: list[str]) -> None:
        import torch

        tokenizer, model = self._loaded or self._load()
        pieces = tokenizer(texts, padding=True, truncation=True, max_length=MOST_PIECES, return_tensors="pt")
        with torch.inference_mode():
            states = model(input_ids=pieces["input_ids"], attention_mask=pieces["attention_mask"]).last_hidden_state
        valid = pieces["attention_mask"].bool().numpy()
        for text, vectors, real in zip(texts, states.float().numpy(), valid):
            self._known[text] = vectors[real].copy()

    def _load(self) -> tuple[Any, Any]:
        from transformers import AutoTokenizer, DistilBertModel

        try:
            tokenizer = AutoTokenizer.from_pretrained(self.source, trust_remote_code=False)
            model = DistilBertModel.from_pretrained(self.source, use_safetensors=True, trust_remote_code=False)
        except (OSError, ValueError, KeyError) as error:
            raise self._unusable(f"none that can be loaded ({_first_line(error)})") from error
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


def _first_line(error: BaseException) -> str:
    return str(error).strip().partition("\n")[0].rstrip(".")[:300] or type(error).__name__
