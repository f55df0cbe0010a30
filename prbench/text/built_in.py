"""The form of encoded text: one vector a token, padded to the longest text of the batch.

The built-in text encoder ``hashed-ngrams``: nothing learned, nothing to download.

A word's vector is the scaled sum of a random vector of its own and one for each of its character 3- to 5-grams, so
that *pick* and *picks* are neighbours. The random vectors come from SHA-256 in whole numbers; the only roundings are
those of single IEEE operations. So the vectors are the same bytes on every machine, for ever. The bundled weights are
trained on them: **nothing here may change**; another recipe is another encoder with another name.
"""

from __future__ import annotations

import hashlib
import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float


@dataclass(frozen=True, eq=False)
class EncodedText:
    """The token vectors of some texts.

    Attributes:
        tokens: float32; zero where there is padding.
        padding: True where a text has no token. Every text has at least one token.
    """

    tokens: Float[np.ndarray, "texts tokens dimension"]
    padding: Bool[np.ndarray, "texts tokens"]


@runtime_checkable
class TextEncoder(Protocol):
    """Frozen: the same text always has the same vectors, whatever stands beside it in a batch."""

    @property
    def name(self) -> str:
        """Name by which weights that were trained with these vectors call them."""
        ...

    @property
    def dimension(self) -> int:
        """Length of a token vector."""
        ...

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The token vectors of some texts (at least one)."""
        ...


def padded(texts: Sequence[Float[np.ndarray, "_ dimension"]], dimension: int) -> EncodedText:
    """Stack the token vectors of texts of different lengths.

    Args:
        texts: The vectors of each text (tokens, dimension); at least one token each.
        dimension: Length of a vector.
    """
    lengths = np.array([len(vectors) for vectors in texts], dtype=np.int64)
    longest = int(lengths.max(initial=1))
    tokens = np.zeros((len(texts), longest, dimension), dtype=np.float32)
    for row, vectors in enumerate(texts):
        tokens[row, : len(vectors)] = vectors
    return EncodedText(tokens, np.arange(longest) >= lengths[:, None])


NAME = "hashed-ngrams"
DIMENSION = 64
MOST_WORDS = 32  # Later words of a text are dropped
_NGRAMS = (3, 4, 5)
_WORD = re.compile(r"[^\W_]+")
_DIGESTS = DIMENSION * 2 // hashlib.sha256().digest_size
_UNIT = np.sqrt(3.0 / (65536.0**2 - 1.0))  # of the odd numbers -65535, -65533 … 65535: makes their variance 1


class HashedNgrams:
    """One token a word; words know nothing of each other or of their place. An empty text is one zero token."""

    name = NAME
    dimension = DIMENSION

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The vectors of the first 32 words of each text (see :class:`prbench.text.TextEncoder`)."""
        return padded([_text_vectors(text) for text in texts], DIMENSION)


def words(text: str) -> list[str]:
    """The lower-case runs of letters and digits of a text, at most 32."""
    return _WORD.findall(unicodedata.normalize("NFC", text).lower())[:MOST_WORDS]


def _text_vectors(text: str) -> Float[np.ndarray, "words 64"]:
    found = words(text)
    if not found:
        return np.zeros((1, DIMENSION), dtype=np.float32)
    return np.stack([_word_vector(word) for word in found])


@lru_cache(maxsize=65536)
def _word_vector(word: str) -> Float[np.ndarray, " 64"]:
    """Sum of the parts over the root of their number: mean 0 and variance 1 over words."""
    grams = ngrams(word)
    integers = sum((_random_integers("ngram", gram) for gram in grams), start=_random_integers("word", word))
    vector = (integers * (_UNIT / np.sqrt(1.0 + len(grams)))).astype(np.float32)
    vector.flags.writeable = False
    return vector


def ngrams(word: str) -> tuple[str, ...]:
    """The distinct runs of 3, 4 and 5 characters of ``<word>``, in the order in which they are met."""
    marked = f"<{word}>"
    return tuple(dict.fromkeys(marked[at : at + n] for n in _NGRAMS for at in range(len(marked) - n + 1)))


def _random_integers(kind: str, text: str) -> np.ndarray:
    """The odd numbers from -65535 to 65535 that belong to a text (64,), int64."""
    seeds = (f"prbench/{NAME}/{kind}/{part}/{text}" for part in range(_DIGESTS))
    digest = b"".join(hashlib.sha256(seed.encode("utf-8")).digest() for seed in seeds)
    return 2 * np.frombuffer(digest, dtype="<u2").astype(np.int64) - 65535
