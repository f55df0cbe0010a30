"""A trained evaluator from its file: networks, statistics and text vectors come together or not at all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from prbench.boundary import foreign_input
from prbench.errors import InputFileError
from prbench.evaluation.text_to_motion.extractor import Extractor
from prbench.evaluation.text_to_motion.networks import (
    EvaluatorConfiguration,
    MotionEncoder,
    MovementEncoder,
    TextEncoder,
)
from prbench.representation import N_FEATURES, Statistics
from prbench.sequences import CorpusTable, SequenceTable
from prbench.training.weights import Weights, read_weights
from prbench.workflows.text_to_motion.clips import token_vectors
from prbench.workflows.text_to_motion.training import EVALUATOR_KIND


@dataclass(frozen=True)
class LoadedEvaluator:
    """An evaluator and the names of what it is made of."""

    extractor: Extractor
    digest: str
    """SHA-256 of its file."""
    words_digest: str
    """Digest of the user's word vectors and lists; empty if it needs none."""

    @property
    def vectorisation(self) -> str:
        """Name of the way in which it reads texts; numbers of different ways never stand in one column."""
        name = self.extractor.configuration.text
        return f"{name}/{self.words_digest[:12]}" if self.words_digest else name


@foreign_input()
def load_evaluator(
    path: Path,
    tables: Iterable[SequenceTable | CorpusTable],
    *,
    device: str = "cpu",
    words: Path | None = None,
    text_path: str | None = None,
) -> LoadedEvaluator:
    """Read a trained evaluator.

    Args:
        path: Its ``.safetensors`` file.
        tables: Whose captions it will be asked about.
        device: Where its networks run.
        words: Folder of the word vectors and lists, for an evaluator of GloVe captions.
        text_path: Folder or hub id of its text encoder, if that has files.

    Raises:
        InputFileError: if the file is none of an evaluator, or the word vectors are others than it was trained with.
        UsageError: if a path is missing or superfluous.
    """
    weights = read_weights(path, kind=EVALUATOR_KIND)
    configuration = weights.configuration(EvaluatorConfiguration)
    weights.require_representation(configuration.representation)
    tokens, words_digest = token_vectors(configuration.text, tables, words=str(words or ""), path=text_path or "")
    _require_words(weights, words_digest)
    movement = MovementEncoder(configuration.movement_width)
    motion = MotionEncoder(configuration)
    text = TextEncoder(configuration, tokens.dimension)
    for name, network in (("movement", movement), ("motion", motion), ("text", text)):
        weights.load_into(network, name)
    mean, std = (weights.require(f"statistics.{name}", (N_FEATURES,)).numpy() for name in ("mean", "std"))
    extractor = Extractor(
        configuration,
        movement,
        motion,
        text,
        statistics=Statistics(mean, std),
        tokens=tokens,
        device=device,
    )
    return LoadedEvaluator(extractor, weights.digest, words_digest)


def _require_words(weights: Weights, digest: str) -> None:
    trained_with = weights.metadata.get("words", "")
    if trained_with != digest:
        raise InputFileError(
            weights.path,
            "header entry 'words'",
            expected=f"the word vectors and lists that it was trained with (sha256 {trained_with[:12]}…)",
            found=f"others (sha256 {digest[:12]}…)",
        )
