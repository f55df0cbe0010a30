"""GloVe word vectors with word classes, as the public text-to-motion evaluator reads captions.

The vectors and the five word lists are a user's own files
(docs/specification/text-to-motion-eval.md#feature-extractor): a folder with ``words.txt`` (one word a line),
``vectors.npy`` (words, 300) in the same order, and for each list a text file such as ``Loc_VIP.txt`` (one word a line).
Nothing is unpickled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.files.arrays import load_array
from prbench.files.bounded import foreign_input, read_text
from prbench.files.storage import bytes_digest, text_digest
from prbench.text.built_in import EncodedText, padded

WORD_DIMENSION = 300
MOST_WORDS = 20
LISTS = ("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP")
"""Hand-made lists of words; a word of one of them has that class instead of its part of speech."""
POS_CLASSES = ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV", *LISTS, "OTHER")
START = "sos"
END = "eos"
UNKNOWN = "unk"
OTHER = "OTHER"


@dataclass(frozen=True, eq=False)
class WordVectors:
    """A vocabulary: a vector a word, and the lists."""

    index: Mapping[str, int]
    vectors: Float[np.ndarray, "words 300"]
    classes: Mapping[str, str]
    """List of each word that is in one; the first of :data:`LISTS` wins."""
    digest: str
    """Digest of everything that decides a number; evaluators are tied to it."""

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> WordVectors:
        """Read the files of a folder.

        Raises:
            InputFileError: if a file is missing or pickled, the two do not fit together, or a needed word is missing.
        """
        words = _lines(folder / "words.txt")
        vectors = _vectors(folder / "vectors.npy", len(words))
        index = {word: row for row, word in enumerate(words)}
        for word in (START, END, UNKNOWN):
            if word not in index:
                raise InputFileError(folder / "words.txt", "", expected=f"the word '{word}'", found="none")
        classes: dict[str, str] = {}
        for name in LISTS:
            classes = dict.fromkeys(_lines(folder / f"{name}.txt"), name) | classes
        listed = "\n".join(f"{word}/{name}" for word, name in sorted(classes.items()))
        return cls(index, vectors, classes, text_digest("\n".join(words), bytes_digest(vectors.tobytes()), listed))

    def encode(self, tokens: str) -> Float[np.ndarray, "words 315"]:
        """The vectors of a caption, each followed by its class as a one-hot vector.

        Args:
            tokens: ``word/POS`` after one another; cut to 20, and framed by markers of start and end.
        """
        pairs = [(word, pos) for word, _, pos in (token.rpartition("/") for token in tokens.split())][:MOST_WORDS]
        rows = [self._row(word, pos) for word, pos in ((START, OTHER), *pairs, (END, OTHER))]
        return np.stack(rows)

    def _row(self, word: str, pos: str) -> Float[np.ndarray, " 315"]:
        if word not in self.index:
            word = UNKNOWN
            pos = OTHER
        kind = self.classes.get(word, pos)
        one_hot = np.zeros(len(POS_CLASSES), dtype=np.float32)
        one_hot[POS_CLASSES.index(kind if kind in POS_CLASSES else OTHER)] = 1.0
        return np.concatenate([self.vectors[self.index[word]], one_hot])


class GloveCaptions:
    """Captions to token vectors by way of their ``word/POS`` tokens (a :class:`prbench.text.TextEncoder`).

    Args:
        vectors: The vocabulary.
        tokens: The tokens of every caption, as the corpus has them.
        source: Where the captions come from, for messages.
    """

    name = "glove"
    dimension = WORD_DIMENSION + len(POS_CLASSES)

    def __init__(self, vectors: WordVectors, tokens: Mapping[str, str], *, source: str) -> None:
        self.vectors, self.tokens, self.source = vectors, tokens, source

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """The vectors of some captions.

        Raises:
            InputFileError: if a caption has no tokens.
        """
        for text in texts:
            if not self.tokens.get(text):
                raise InputFileError(
                    self.source,
                    "captions",
                    expected="word/POS tokens beside every caption, which a GloVe evaluator reads",
                    found=f"none of '{text}'",
                    remedy="HumanML3D brings them. For other corpora train an evaluator with model.text=hashed-ngrams"
                    " or distilbert; its numbers form a column of their own.",
                )
        return padded([self.vectors.encode(self.tokens[text]) for text in texts], self.dimension)


def _lines(path: Path) -> list[str]:
    try:
        return read_text(path, encoding="utf-8").rstrip("\n").split("\n")
    except FileNotFoundError as error:
        raise InputFileError(
            path,
            "",
            expected="a text file with one word a line",
            found="no such file",
            remedy="Convert the public vocabulary once, where you trust its pickles.",
        ) from error
    except UnicodeDecodeError as error:
        raise InputFileError(path, "", expected="UTF-8 text", found=str(error)) from error


def _vectors(path: Path, words: int) -> Float[np.ndarray, "words 300"]:
    expected = f"an array of shape ({words}, {WORD_DIMENSION}), one row a word of words.txt"
    vectors = load_array(path)
    if vectors.shape != (words, WORD_DIMENSION) or not np.issubdtype(vectors.dtype, np.floating):
        raise InputFileError(path, "", expected=expected, found=f"shape {vectors.shape} of {vectors.dtype}")
    return vectors.astype(np.float32)
