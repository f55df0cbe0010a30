"""Texts as pieces and back: the words of the training texts, or GPT-2's pieces."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from prbench.errors import MissingExtraError
from prbench.files.bounded import require, require_size
from prbench.limits import HARMLESS_SIZE

GPT2_VARIABLE = "PRBENCH_GPT2"  # environment variable: a local folder or a hub id that was downloaded before
_GPT2_HUB_ID = "openai-community/gpt2"
_PIECE = re.compile(r"[^\W_]+(?:['’-][^\W_]+)*|[^\w\s]")
_BEFORE = re.compile(r" (?=[.,;:!?)])")  # what stands before no blank
_UNKNOWN = "<unknown>"
_REMEDY = (
    f"Run once, where there is internet: hf download {_GPT2_HUB_ID} vocab.json merges.txt --local-dir gpt2;"
    f" then set {GPT2_VARIABLE}=gpt2. Or train with --set model.text=words."
)


class Words:
    """Words and punctuation as they are written; id 0 stands for all others."""

    def __init__(self, words: Sequence[str]) -> None:
        self.words = tuple(words)
        self._places = {word: place for place, word in enumerate(words)}

    def __len__(self) -> int:
        return len(self.words)

    def encode(self, text: str) -> list[int]:
        """Return the ids of a text's words."""
        return [self._places.get(word, 0) for word in _PIECE.findall(text)]

    def decode(self, ids: Sequence[int]) -> str:
        """Return the text of some words; unknown ones are left out."""
        return _BEFORE.sub("", " ".join(self.words[each] for each in ids if each))


def words_of(texts: Iterable[str]) -> tuple[str, ...]:
    """Return the vocabulary of some texts: a word for unknown ones, then the others, the most frequent first."""
    counts = Counter(word for text in texts for word in _PIECE.findall(text))
    return (_UNKNOWN, *sorted(counts, key=lambda word: (-counts[word], word)))


def gpt2() -> Any:
    """Return GPT-2's byte pairs, which any text is made of; prbench downloads nothing.

    Raises:
        MissingExtraError: if transformers is not installed.
        InputFileError: if its files are not there; the message says how to get them.
    """
    try:
        from transformers import GPT2TokenizerFast  # pyright: ignore[reportAttributeAccessIssue] - an alias made late
    except ModuleNotFoundError as error:
        raise MissingExtraError("transformers", "text", "GPT-2's pieces of text") from error
    source = os.environ.get(GPT2_VARIABLE) or _GPT2_HUB_ID
    for file in Path(source).iterdir() if Path(source).is_dir() else ():
        require_size(file, largest=HARMLESS_SIZE)
    given = {"local_files_only": True, "trust_remote_code": False, "clean_up_tokenization_spaces": False}
    tokenizer: Any = ()
    why = ""
    try:
        tokenizer = GPT2TokenizerFast.from_pretrained(source, **given)
    except (OSError, ValueError, KeyError, TypeError) as error:
        why = f" ({str(error).partition('. ')[0][:200]})"
    # transformers takes missing files for a vocabulary of one piece.
    found = f"{len(tokenizer)} pieces{why}"
    require(source, (len(tokenizer) > 256, "", "GPT-2's vocab.json and merges.txt", found, _REMEDY))
    return tokenizer


def vocabulary_of(text: str, words: Sequence[str]) -> Any:
    """Return what has a length, ``encode`` of a text to ids and ``decode`` of ids, for ``gpt2`` or for ``words``."""
    return gpt2() if text == "gpt2" else Words(words)
