"""Train a text-motion evaluator: reconstruction first, then contrast; and its task of ``prbench train``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import nn
from torch.nn.functional import pairwise_distance

from prbench.errors import TableError, UsageError
from prbench.files.bounded import foreign_input, require
from prbench.representation import N_FEATURES, Statistics
from prbench.sequences import CorpusTable, SequenceTable
from prbench.text import TextEncoder as TokenVectors
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import Weights, read_weights, representation_entry
from prbench_benchmarks.text_to_motion import networks as nets
from prbench_benchmarks.text_to_motion.clips import Extractor, cut_tokens, token_vectors

Features = Float[torch.Tensor, "batch frames 263"]

Stage = Literal["full", "autoencoder", "contrastive"]
STAGES: tuple[Stage, ...] = ("full", "autoencoder", "contrastive")
EVALUATOR_KIND = "t2m-evaluator"
MOVEMENT_KIND = "t2m-movement"  # Kinds of weights files: a whole evaluator, or a trained movement autoencoder alone.
# Probability that a motion loses one more snippet than its length needs (docs/specification/mdm.md#training).
_SHORTER = 1 / 3


class EvaluatorObjective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of ``[model]`` beside those of the networks. Defaults are those of the text-to-motion paper.

    Attributes:
        autoencoder_batches: Batches of stage ``full`` that train the movement autoencoder, before it is frozen.
        window: Frames of a clip of the autoencoder.
        windows: Clips drawn from every motion of a batch.
        sparsity: Weight of the mean size of the snippets' numbers.
        smoothness: Weight of the mean difference of neighbouring snippets.
        margin: Distance beyond which a wrong pair costs nothing.
        equal_texts_are_negatives: Push a motion away from another one's text even if both have the same text, as the
            original does.
        words: Folder of the word vectors and lists, for ``text = "glove"``.
        text_path: Folder or hub id of the text encoder, for ``text = "distilbert"``; by default that of the
            environment.
    """

    autoencoder_batches: int = 0
    window: int = 24
    windows: int = 1
    sparsity: float = 0.001
    smoothness: float = 0.001
    margin: float = 10.0
    equal_texts_are_negatives: bool = True
    words: str = ""
    text_path: str = ""

    def __post_init__(self) -> None:
        if self.window < 4 or self.window % 4:
            raise ValueError("`window` must be a multiple of 4")
        if self.windows < 1 or self.autoencoder_batches < 0:
            raise ValueError("`windows` must be 1 or more, `autoencoder_batches` 0 or more")


def reconstruction_losses(
    objective: EvaluatorObjective,
    recorded: Float[torch.Tensor, "clips frames 259"],
    reconstructed: Float[torch.Tensor, "clips frames 259"],
    snippets: Float[torch.Tensor, "clips snippets width"],
    n_frames: Int[torch.Tensor, " clips"],
) -> dict[str, torch.Tensor]:
    """L1 of the valid frames, with snippets that are sparse and change smoothly.

    Returns:
        ``loss`` and its parts ``reconstruction``, ``sparsity``, ``smoothness``.
    """
    valid = torch.arange(recorded.shape[1], device=recorded.device) < n_frames[:, None]
    reconstruction = (recorded - reconstructed).abs().mean(dim=-1)[valid].mean()
    sparsity = snippets.abs().mean()
    smoothness = snippets.diff(dim=1).abs().mean() if snippets.shape[1] > 1 else 0.0
    loss = reconstruction + objective.sparsity * sparsity + objective.smoothness * smoothness
    return {"loss": loss, "reconstruction": reconstruction}


def contrastive_losses(
    text: Float[torch.Tensor, "batch dimension"],
    motion: Float[torch.Tensor, "batch dimension"],
    *,
    shift: int,
    margin: float,
    counted: Bool[torch.Tensor, " batch"] | None = None,
) -> dict[str, torch.Tensor]:
    """Pull each text to its own motion, push it from the one ``shift`` rows before (1 to batch - 1).

    Args:
        text: Embeddings of the texts.
        motion: Embeddings of their motions.
        shift: 0 would pair every text with its own motion as a negative, as the reference sometimes does.
        margin: Distance beyond which a wrong pair costs nothing.
        counted: Which of the wrong pairs count; all by default.

    Returns:
        ``loss`` and its parts ``positive`` (mean D²) and ``negative`` (mean max(0, margin - D)²), and ``ranked``: the
        share of texts that are nearer to their own motion than to the wrong one.
    """
    assert 0 < shift < len(text)
    near = pairwise_distance(text, motion)
    far = pairwise_distance(text, motion.roll(shift, dims=0))
    positive = near.square().mean()
    wrong = (margin - far).clamp_min(0.0).square()
    if counted is not None:
        wrong = wrong * counted
    negative = wrong.mean() if counted is None else wrong.sum() / counted.sum().clamp_min(1)
    ranked = (near < far).float().mean().detach()
    return {"loss": positive + negative, "positive": positive, "negative": negative, "ranked": ranked}


def different_texts(texts: Sequence[str], shift: int) -> Bool[torch.Tensor, " batch"]:
    """Return True for each row whose text differs from that of the motion ``shift`` rows before."""
    return torch.tensor([text != texts[row - shift] for row, text in enumerate(texts)])


class EvaluatorTraining(TrainingModule):
    """The evaluator's networks with their losses.

    Stage ``full`` trains the autoencoder for the first batches and everything else afterwards; the stages
    ``autoencoder`` and ``contrastive`` are those two halves as trainings of their own.

    Args:
        configuration: Sizes of the networks.
        objective: Weights of the losses.
        stage: Which half, or both.
        statistics: Weighted for an evaluator.
        tokens: Vectors of the words of a text.
        words_digest: Digest of a vocabulary that the user supplies; empty if there is none.
        origin: Lines for the card.
    """

    def __init__(
        self,
        configuration: nets.EvaluatorConfiguration,
        objective: EvaluatorObjective,
        *,
        stage: Stage,
        statistics: Statistics,
        tokens: TokenVectors,
        words_digest: str = "",
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.configuration, self.objective, self.stage = configuration, objective, stage
        self.tokens, self.words_digest, self.origin = tokens, words_digest, origin
        self.movement = nets.MovementEncoder(configuration.movement_width)
        self.decoder = nets.MovementDecoder(configuration.movement_width)
        self.motion = nets.motion_encoder(configuration)
        self.text = nets.TextEncoder(configuration, tokens.dimension)
        self.mean: torch.Tensor
        self.std: torch.Tensor
        self.register_buffer("mean", torch.from_numpy(statistics.mean.copy()), persistent=False)
        self.register_buffer("std", torch.from_numpy(statistics.std.copy()), persistent=False)
        for network, stages in (
            (self.movement, ("full", "autoencoder")),
            (self.decoder, ("full", "autoencoder")),
            (self.motion, ("full", "contrastive")),
            (self.text, ("full", "contrastive")),
        ):
            network.requires_grad_(stage in stages)

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Return the losses of the phase that a step belongs to.

        Returns:
            ``loss``, and ``reconstruction`` of the autoencoder or ``positive``, ``negative``, ``ranked`` of the
            contrast; in stage ``full`` all of them, those of the other phase being zero.

        Raises:
            TableError: if motions are too short, or a batch has no second motion to contrast with.
        """
        # Validation, a step below 0, judges the final result.
        first = self.stage == "full" and 0 <= step < self.objective.autoencoder_batches
        step_of = self.reconstruct if first or self.stage == "autoencoder" else self.contrast
        found = step_of(batch, step)
        if self.stage != "full":
            return found
        absent = found["loss"].new_zeros(())
        return {name: found.get(name, absent) for name in ("loss", "reconstruction", "positive", "negative", "ranked")}

    def reconstruct(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Short clips of every motion through the autoencoder."""
        self.movement.train(self.training)
        features = self._standardised(batch.features)
        lengths = (batch.n_frames.clamp_max(self.objective.window) // nets.SNIPPET * nets.SNIPPET).to(features.device)
        _require_snippets(lengths, batch)
        chances = torch.rand(len(features), self.objective.windows, generator=self.generator(step))
        # Motions that are shorter than a window start at 0; their padding is masked by the lengths.
        room = (batch.n_frames - self.objective.window).clamp_min(0)
        starts = (chances.to(room.device) * (room[:, None] + 1)).long().flatten()
        rows = torch.arange(len(features), device=room.device).repeat_interleave(self.objective.windows)
        # ``window`` frames from each start; beyond the end of the batch the last frame is repeated, to be masked.
        frames = starts[:, None] + torch.arange(self.objective.window, device=starts.device)
        clips = features[rows[:, None], frames.clamp_max(features.shape[1] - 1)]
        lengths = lengths[rows]
        snippets = self.movement(clips, lengths)
        return reconstruction_losses(self.objective, clips, self.decoder(snippets), snippets, lengths)

    def contrast(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Texts and motions of a batch against each other, on snippets of the frozen movement encoder."""
        if len(batch) < 2 and step >= 0:
            raise TableError("a contrast needs two motions or more in a batch; raise training.batch_size.")
        generator = self.generator(step)
        shorter = torch.rand(len(batch), generator=generator) < _SHORTER
        # Never 0, which would make a text's own motion its negative.
        shift = int(torch.randint(1, max(len(batch), 2), (1,), generator=generator))
        counts = batch.n_frames // nets.SNIPPET
        _require_snippets(counts, batch)
        counts = torch.where(shorter.to(counts.device) & (counts > 1), counts - 1, counts)
        # Frozen in this phase, and without dropout, as it will be at evaluation.
        self.movement.eval()
        features = self._standardised(batch.features)[:, : int(counts.max()) * nets.SNIPPET]
        with torch.no_grad():
            snippets = self.movement(features, counts * nets.SNIPPET)
        tokens, lengths = cut_tokens(self.tokens.encode(batch.text), self.configuration)
        text = self.text(tokens.to(features.device), lengths)
        motion = self.motion(snippets, counts)
        if len(batch) < 2:  # what was left over of the validation split has nothing wrong to meet
            # :func:`contrastive_losses` where there is no wrong pair.
            positive = pairwise_distance(text, motion).square().mean()
            return {"loss": positive, "positive": positive, "negative": torch.zeros_like(positive)}
        counted = None
        if not self.objective.equal_texts_are_negatives:
            counted = different_texts(batch.text, shift).to(batch.features.device)
        return contrastive_losses(text, motion, shift=shift, margin=self.objective.margin, counted=counted)

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Networks and statistics as one object; the decoder is kept where a contrast is still to follow."""
        half = self.stage == "autoencoder"
        networks: dict[str, nn.Module] = {"movement": self.movement}
        networks |= {"decoder": self.decoder} if half else {"motion": self.motion, "text": self.text}
        tensors = {
            f"{name}.{key}": tensor
            for name, network in networks.items()
            for key, tensor in network.state_dict().items()
        }
        tensors |= {"statistics.mean": self.mean, "statistics.std": self.std}
        metadata = {
            "kind": MOVEMENT_KIND if half else EVALUATOR_KIND,
            "configuration": msgspec.json.encode(self.configuration).decode(),
            "representation": representation_entry(self.configuration.representation),
            "words": self.words_digest,
        }
        return tensors, metadata

    def gradient_groups(self) -> tuple[tuple[nn.Parameter, ...], ...]:
        """Each network's gradient is clipped by its own norm."""
        networks = (self.movement, self.decoder, self.motion, self.text)
        return tuple(tuple(network.parameters()) for network in networks)

    def _standardised(self, features: Features) -> Float[torch.Tensor, "batch frames 259"]:
        return ((features - self.mean) / self.std)[..., : nets.MOVEMENT_FEATURES]


def _require_snippets(counts: Int[torch.Tensor, " batch"], batch: MotionBatch) -> None:
    if int(counts.min()) < 1:
        row = int(counts.argmin())
        problem = f"an evaluator needs motions of {nets.SNIPPET} frames or more, found {int(batch.n_frames[row])}."
        raise TableError(f"{batch.sequence_id[row]}: {problem}")


# Fields of the configuration that describe the movement encoder, which stage ``contrastive`` takes over.
_MOVEMENT_ENCODER = frozenset({"movement_width", "representation", "fps"})


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
        configuration, objective = split_model_table(model, nets.EvaluatorConfiguration, EvaluatorObjective)
        data.require_fit("the evaluator", configuration)
        alone = not torch.distributed.is_initialized() or torch.distributed.get_world_size() == 1
        if stage == "contrastive" and initial is None:
            raise UsageError("--stage contrastive needs --init FILE: the weights that --stage autoencoder has left.")
        if stage != "contrastive" and initial is not None:
            raise UsageError(f"--stage {stage} starts from nothing; --init belongs to --stage contrastive.")
        if stage == "full" and objective.autoencoder_batches < 1:
            raise UsageError("--stage full needs model.autoencoder_batches: batches that train the autoencoder first.")
        if stage == "full" and not alone:
            remedy = "With several, run --stage autoencoder, then --stage contrastive with its weights as --init."
            raise UsageError(f"--stage full trains in one process. {remedy}")
        start = read_weights(initial, kind=MOVEMENT_KIND) if initial is not None else None
        sources = {"words": objective.words, "path": objective.text_path}
        tokens, words_digest = token_vectors(configuration.text, data.train.tables, **sources)
        lines = [f"text vectors {configuration.text} (frozen)"]
        if configuration.text == nets.GLOVE:
            lines = [f"word vectors and lists, sha256 {words_digest} (frozen)"]
        if start is not None:
            lines.append(f"movement encoder {start.path.name}, sha256 {start.digest} (frozen)")
        statistics = data.train.statistics().for_evaluator() if start is None else _stored_statistics(start)
        about = {"tokens": tokens, "words_digest": words_digest, "origin": tuple(lines)}
        stage_name = cast(Stage, stage)
        module = EvaluatorTraining(configuration, objective, stage=stage_name, statistics=statistics, **about)
        if start is not None:
            # Take over the trained movement encoder.
            # Only the movement encoder is taken over, so only its fields have to agree.
            irrelevant = frozenset(nets.EvaluatorConfiguration.__struct_fields__) - _MOVEMENT_ENCODER
            start.require_same(module.configuration, apart_from=irrelevant)
            start.load_into(module.movement, "movement")
        return module


def _stored_statistics(weights: Weights) -> Statistics:
    mean, std = (weights.require(f"statistics.{name}", (N_FEATURES,)).numpy() for name in ("mean", "std"))
    return Statistics(mean, std)


@foreign_input()
def load_evaluator(
    path: Path,
    tables: Iterable[SequenceTable | CorpusTable],
    *,
    device: str = "cpu",
    words: Path | None = None,
    text_path: str | None = None,
) -> Extractor:
    """Read a trained evaluator.

    Args:
        path: Its ``.safetensors`` file.
        tables: Whose captions it will be asked about.
        device: Device that its networks run on.
        words: Folder of the word vectors and lists, for an evaluator of GloVe captions.
        text_path: Folder or hub id of its text encoder, if that has files.

    Raises:
        InputFileError: if the file is none of an evaluator, or the word vectors are others than it was trained with.
        UsageError: if a path is missing or superfluous.
    """
    weights = read_weights(path, kind=EVALUATOR_KIND)
    configuration = weights.configuration(nets.EvaluatorConfiguration)
    weights.require_representation(configuration.representation)
    tokens, words_digest = token_vectors(configuration.text, tables, words=str(words or ""), path=text_path or "")
    # Other word vectors would load without an error and give numbers that mean nothing.
    trained_with = weights.metadata.get("words", "")
    expected = f"the word vectors and lists that it was trained with (sha256 {trained_with[:12]}…)"
    found = f"others (sha256 {words_digest[:12]}…)"
    require(weights.path, (trained_with == words_digest, "header entry 'words'", expected, found, ""))
    movement = nets.MovementEncoder(configuration.movement_width)
    motion = nets.motion_encoder(configuration)
    text = nets.TextEncoder(configuration, tokens.dimension)
    for name, network in (("movement", movement), ("motion", motion), ("text", text)):
        weights.load_into(network, name)
    digests: dict[str, Any] = {"digest": weights.digest, "words_digest": words_digest}
    about = {"statistics": _stored_statistics(weights), "tokens": tokens, "device": device}
    return Extractor(configuration, movement, motion, text, **about, **digests)
