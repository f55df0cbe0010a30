"""The evaluator's networks with their sizes, and captions as it reads them: GloVe vectors with word classes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import torch
from jaxtyping import Float, Int
from torch import nn
from torch.nn.utils.rnn import pack_padded_sequence

from prbench.files.arrays import load_array
from prbench.files.bounded import foreign_input, read_text, require
from prbench.files.storage import bytes_digest, text_digest
from prbench.representation import N_FEATURES, Mode
from prbench.representation.features import FOOT_CONTACTS
from prbench.text import EncodedText, padded
from prbench_adapters.training.configuration import require_within

Steps = Float[torch.Tensor, "batch steps channels"]
Inputs = Float[torch.Tensor, "batch steps inputs"]

Tokens = Float[torch.Tensor, "batch tokens dimension"]

WORD_DIMENSION = 300
MOST_WORDS = 20
# Hand-made lists of words; a word of one of them has that class instead of its part of speech.
LISTS = ("Loc_VIP", "Body_VIP", "Obj_VIP", "Act_VIP", "Desc_VIP")
POS_CLASSES = ("VERB", "NOUN", "DET", "ADP", "NUM", "AUX", "PRON", "ADJ", "ADV", *LISTS, "OTHER")
START = "sos"
END = "eos"
UNKNOWN = "unk"
OTHER = "OTHER"


@dataclass(frozen=True, eq=False)
class WordVectors:
    """A vocabulary: a vector a word, and the lists.

    Attributes:
        classes: List of each word that is in one; the first of :data:`LISTS` wins.
        digest: Digest of everything that decides a number; evaluators are tied to it.
    """

    index: Mapping[str, int]
    vectors: Float[np.ndarray, "words 300"]
    classes: Mapping[str, str]
    digest: str

    @classmethod
    @foreign_input()
    def read(cls, folder: Path) -> WordVectors:
        """Read the files of a folder.

        Raises:
            InputFileError: if a file is missing or pickled, the two do not fit together, or a needed word is missing.
        """
        words = _lines(folder / "words.txt")
        path = folder / "vectors.npy"
        vectors = load_array(path)
        fits = vectors.shape == (len(words), WORD_DIMENSION) and np.issubdtype(vectors.dtype, np.floating)
        expected = f"an array of shape ({len(words)}, {WORD_DIMENSION}), one row a word of words.txt"
        require(path, (fits, "", expected, f"shape {vectors.shape} of {vectors.dtype}", ""))
        vectors = vectors.astype(np.float32)
        index = {word: row for row, word in enumerate(words)}
        markers = ((word in index, "", f"the word '{word}'", "none", "") for word in (START, END, UNKNOWN))
        require(folder / "words.txt", *markers)
        classes: dict[str, str] = {}
        for name in LISTS:
            classes = dict.fromkeys(_lines(folder / f"{name}.txt"), name) | classes
        listed = "\n".join(f"{word}/{name}" for word, name in sorted(classes.items()))
        return cls(index, vectors, classes, text_digest("\n".join(words), bytes_digest(vectors.tobytes()), listed))

    def encode(self, tokens: str) -> Float[np.ndarray, "words 315"]:
        """Return the vectors of a caption, each followed by its class as a one-hot vector.

        Args:
            tokens: ``word/POS`` after one another; cut to 20, and framed by markers of start and end.
        """
        pairs = [(word, pos) for word, _, pos in (token.rpartition("/") for token in tokens.split())][:MOST_WORDS]
        return np.stack([self._row(word, pos) for word, pos in ((START, OTHER), *pairs, (END, OTHER))])

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
        source: The origin of the captions, for messages.
    """

    name = "glove"
    dimension = WORD_DIMENSION + len(POS_CLASSES)

    def __init__(self, vectors: WordVectors, tokens: Mapping[str, str], *, source: str) -> None:
        self.vectors, self.tokens, self.source = vectors, tokens, source

    def encode(self, texts: Sequence[str]) -> EncodedText:
        """Return the vectors of some captions.

        Raises:
            InputFileError: if a caption has no tokens.
        """
        expected = "word/POS tokens beside every caption, which a GloVe evaluator reads"
        remedy = (
            "HumanML3D brings them. For other corpora train an evaluator with model.text=hashed-ngrams or distilbert;"
            " its numbers form a column of their own."
        )
        for text in texts:
            require(self.source, (self.tokens.get(text), "captions", expected, f"none of '{text}'", remedy))
        return padded([self.vectors.encode(self.tokens[text]) for text in texts], self.dimension)


def _lines(path: Path) -> list[str]:
    remedy = "Convert the public vocabulary once, where you trust its pickles."
    return read_text(path, expected="a text file with one word a line", remedy=remedy).rstrip("\n").split("\n")


# Number of the 263 features that the movement encoder sees: all but the four contacts.
MOVEMENT_FEATURES = FOOT_CONTACTS.start
SNIPPET = 4  # Frames that become one snippet.
GLOVE = "glove"
_SLOPE = 0.2
_DROPOUT = 0.2


assert N_FEATURES - MOVEMENT_FEATURES == 4


class EvaluatorConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Defaults are those of the text-to-motion paper.

    Source: docs/specification/text-to-motion-eval.md#training-the-extractor.

    Attributes:
        movement_width: Channels of the movement encoder, and numbers of a snippet.
        motion_width: Hidden size of the motion encoder's GRU, in each direction.
        text_width: Hidden size of the text encoder's GRU, in each direction.
        embedding: Dimension of the space that both encoders map into.
        text: Name of the word vectors that the text encoder reads. Numbers of different ones never stand in one column.
        most_tokens: Later tokens of a text are dropped. GloVe's captions are cut to 20 words whatever stands here.
        max_frames: Longer motions are cropped to this before they are embedded.
    """

    movement_width: int = 512
    motion_width: int = 1024
    text_width: int = 512
    embedding: int = 512
    text: Literal["glove", "hashed-ngrams", "distilbert"] = "glove"
    most_tokens: int = 64
    representation: Mode = "continuous"
    fps: float = 20.0
    max_frames: int = 196

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "movement_width", "motion_width", "text_width", "embedding", "most_tokens")
        if self.max_frames < SNIPPET:
            raise ValueError(f"`max_frames` must be {SNIPPET} or more")


class MovementEncoder(nn.Module):
    """Four frames to one snippet: two strided convolutions over time.

    Args:
        width: Channels, and numbers of a snippet.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first = _halving(MOVEMENT_FEATURES, width)
        self.second = _halving(width, width)
        self.output = nn.Linear(width, width)

    def forward(
        self, features: Float[torch.Tensor, "batch frames 259"], n_frames: Int[torch.Tensor, " batch"]
    ) -> Float[torch.Tensor, "batch snippets width"]:
        """Snippets of a motion, frames // 4 of them; each motion's are those that it has alone.

        A convolution pads what it is given with zeros, so beyond its end every motion is zero before either of them,
        however long its neighbours in the batch are.

        Args:
            features: Standardised features without contacts.
            n_frames: Frames of each motion, a multiple of 4; what stands behind is never looked at.
        """
        half = self.first(_ended(features, n_frames).transpose(1, 2)).transpose(1, 2)
        return self.output(self.second(_ended(half, n_frames // 2).transpose(1, 2)).transpose(1, 2))


class MovementDecoder(nn.Module):
    """The mirror of the movement encoder, needed while that is trained.

    Args:
        width: Numbers of a snippet.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.input = nn.Linear(width, width)
        self.convolutions = nn.Sequential(
            nn.LeakyReLU(_SLOPE),
            nn.ConvTranspose1d(width, width, 4, stride=2, padding=1),
            nn.LeakyReLU(_SLOPE),
            nn.ConvTranspose1d(width, MOVEMENT_FEATURES, 4, stride=2, padding=1),
        )

    def forward(self, snippets: Float[torch.Tensor, "batch snippets width"]) -> Float[torch.Tensor, "batch frames 259"]:
        """Standardised features of four frames for each snippet."""
        return self.convolutions(self.input(snippets).transpose(1, 2)).transpose(1, 2)


class SequenceEncoder(nn.Module):
    """Linear, bidirectional GRU with a learned initial state, and a head on the last states of both directions.

    Args:
        inputs: Numbers of one step.
        inner: What each step is mapped to before the GRU.
        width: Width of the GRU in each direction.
        hidden: Width of the head's middle layer.
        outputs: Width of the embedding.
    """

    def __init__(self, inputs: int, inner: int, width: int, hidden: int, outputs: int) -> None:
        super().__init__()
        self.input = nn.Linear(inputs, inner)
        self.gru = nn.GRU(inner, width, batch_first=True, bidirectional=True)
        self.initial = nn.Parameter(torch.randn(2, 1, width))
        self.head = nn.Sequential(
            nn.Linear(2 * width, hidden), nn.LayerNorm(hidden), nn.LeakyReLU(_SLOPE), nn.Linear(hidden, outputs)
        )

    def forward(self, steps: Inputs, lengths: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch outputs"]:
        """One embedding a row; row i is that of its first ``lengths[i]`` steps alone, wherever it stands."""
        packed = pack_padded_sequence(self.input(steps), lengths.cpu(), batch_first=True, enforce_sorted=False)
        _, last = self.gru(packed, self.initial.expand(-1, len(steps), -1).contiguous())
        return self.head(torch.cat((last[0], last[1]), dim=-1))


def motion_encoder(configuration: EvaluatorConfiguration) -> SequenceEncoder:
    """Snippets to an embedding."""
    width = configuration.motion_width
    return SequenceEncoder(configuration.movement_width, width, width, width, configuration.embedding)


class TextEncoder(nn.Module):
    """Token vectors to an embedding; those of GloVe bring the word's class along, which is added to its vector.

    Args:
        configuration: The evaluator's configuration.
        dimension: Width of the token vectors.
    """

    def __init__(self, configuration: EvaluatorConfiguration, dimension: int) -> None:
        super().__init__()
        words = WORD_DIMENSION if configuration.text == GLOVE else dimension
        self.classes = nn.Linear(len(POS_CLASSES), words) if configuration.text == GLOVE else None
        width = configuration.text_width
        self.sequence = SequenceEncoder(words, width, width, width, configuration.embedding)

    def forward(self, tokens: Tokens, lengths: Int[torch.Tensor, " batch"]) -> Float[torch.Tensor, "batch outputs"]:
        """One embedding a text."""
        if self.classes is not None:
            tokens = tokens[..., :WORD_DIMENSION] + self.classes(tokens[..., WORD_DIMENSION:])
        return self.sequence(tokens, lengths)


def _halving(inputs: int, outputs: int) -> nn.Sequential:
    # Kernel 4, stride 2, padding 1 halves the frames exactly, so four frames are one snippet after two.
    convolution = nn.Conv1d(inputs, outputs, 4, stride=2, padding=1)
    return nn.Sequential(convolution, nn.Dropout(_DROPOUT), nn.LeakyReLU(_SLOPE))


def _ended(steps: Steps, lengths: Int[torch.Tensor, " batch"]) -> Steps:
    """Zero from each row's length on."""
    beyond = torch.arange(steps.shape[1], device=steps.device) >= lengths[:, None]
    return steps.masked_fill(beyond[..., None], 0.0)
