"""An evaluator before and after its training.

Before: the training task ``t2m-evaluator`` makes the module to train from a ``[model]`` table and data. After:
networks, statistics and text vectors are read from its file together, or not at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import torch

from prbench.errors import InputFileError, UsageError
from prbench.files.bounded import foreign_input
from prbench.representation import N_FEATURES, Statistics
from prbench.sequences import CorpusTable, SequenceTable
from prbench_adapters.training.task import TrainingData, split_model_table
from prbench_adapters.training.weights import Weights, read_weights
from prbench_benchmarks.text_to_motion.clips import token_vectors
from prbench_benchmarks.text_to_motion.extractor import Extractor
from prbench_benchmarks.text_to_motion.networks import (
    GLOVE,
    EvaluatorConfiguration,
    MotionEncoder,
    MovementEncoder,
    TextEncoder,
)
from prbench_benchmarks.text_to_motion.training import (
    EVALUATOR_KIND,
    MOVEMENT_KIND,
    STAGES,
    EvaluatorObjective,
    EvaluatorTraining,
    Stage,
)

_MOVEMENT_ENCODER = frozenset({"movement_width", "representation", "fps"})
"""Fields of the configuration that describe the movement encoder, which stage ``contrastive`` takes over."""


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


def t2m_evaluator() -> EvaluatorTask:
    """Entry point ``t2m-evaluator``."""
    return EvaluatorTask()


@dataclass(frozen=True)
class EvaluatorTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str = "t2m-evaluator"
    configurations: str = "prbench_benchmarks.text_to_motion.configurations"
    stages: tuple[str, ...] = STAGES

    def build(
        self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str
    ) -> EvaluatorTraining:
        """Make the networks in their state before the first step.

        Args:
            model: Keys of :class:`EvaluatorConfiguration` and of :class:`EvaluatorObjective`.
            data: The training split.
            initial: The trained autoencoder that stage ``contrastive`` starts from, and no other stage.
            stage: ``full``, ``autoencoder`` or ``contrastive``.

        Raises:
            UsageError: if the table does not describe an evaluator, or stage and initial weights do not fit together.
            InputFileError: if the initial weights or the word vectors do not fit it.
        """
        configuration, objective = read_model_table(model)
        data.require_fit(
            "the evaluator",
            representation=configuration.representation,
            fps=configuration.fps,
            max_frames=configuration.max_frames,
        )
        _require_stage(stage, initial, objective)
        start = read_weights(initial, kind=MOVEMENT_KIND) if initial is not None else None
        tokens, words_digest = token_vectors(
            configuration.text, data.train.tables, words=objective.words, path=objective.text_path
        )
        module = EvaluatorTraining(
            configuration,
            objective,
            stage=cast(Stage, stage),
            statistics=_statistics(start, data),
            tokens=tokens,
            words_digest=words_digest,
            origin=_origin(configuration, words_digest, start),
        )
        if start is not None:
            _continue_from(module, start)
        return module


def read_model_table(model: Mapping[str, Any]) -> tuple[EvaluatorConfiguration, EvaluatorObjective]:
    """Split the table ``[model]`` into the networks and what they are trained for.

    Raises:
        UsageError: for an unknown key or a value of a wrong kind.
    """
    return split_model_table(model, EvaluatorConfiguration, EvaluatorObjective)


def _require_stage(stage: str, initial: Path | None, objective: EvaluatorObjective) -> None:
    if stage == "contrastive" and initial is None:
        raise UsageError("--stage contrastive needs --init FILE: the weights that --stage autoencoder has left.")
    if stage != "contrastive" and initial is not None:
        raise UsageError(f"--stage {stage} starts from nothing; --init belongs to --stage contrastive.")
    if stage == "full" and objective.autoencoder_batches < 1:
        raise UsageError("--stage full needs model.autoencoder_batches: how many batches train the autoencoder first.")
    if stage == "full" and torch.distributed.is_initialized() and torch.distributed.get_world_size() > 1:
        raise UsageError(
            "--stage full trains in one process. With several, run --stage autoencoder, then --stage contrastive"
            " with its weights as --init."
        )


def _statistics(start: Weights | None, data: TrainingData) -> Statistics:
    if start is None:
        return data.train.statistics().for_evaluator()
    return _stored_statistics(start)


def _stored_statistics(weights: Weights) -> Statistics:
    mean, std = (weights.require(f"statistics.{name}", (N_FEATURES,)).numpy() for name in ("mean", "std"))
    return Statistics(mean, std)


def _continue_from(module: EvaluatorTraining, start: Weights) -> None:
    """Take over the trained movement encoder.

    Raises:
        InputFileError: if it is one of another size or representation.
    """
    # Only the movement encoder is taken over, so only its fields have to agree.
    irrelevant = frozenset(EvaluatorConfiguration.__struct_fields__) - _MOVEMENT_ENCODER
    start.require_same(module.configuration, apart_from=irrelevant)
    start.load_into(module.movement, "movement")


def _origin(configuration: EvaluatorConfiguration, words_digest: str, start: Weights | None) -> tuple[str, ...]:
    lines = [f"text vectors {configuration.text} (frozen)"]
    if configuration.text == GLOVE:
        lines = [f"word vectors and lists, sha256 {words_digest} (frozen)"]
    if start is not None:
        lines.append(f"movement encoder {start.path.name}, sha256 {start.digest} (frozen)")
    return tuple(lines)


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
    # Other word vectors would load without an error and give numbers that mean nothing.
    _require_words(weights, words_digest)
    movement = MovementEncoder(configuration.movement_width)
    motion = MotionEncoder(configuration)
    text = TextEncoder(configuration, tokens.dimension)
    for name, network in (("movement", movement), ("motion", motion), ("text", text)):
        weights.load_into(network, name)
    extractor = Extractor(
        configuration,
        movement,
        motion,
        text,
        statistics=_stored_statistics(weights),
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
