"""Train motion tokens, and read trained ones: the task ``motion-tokens`` of ``prbench train``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import torch
from torch.nn.functional import smooth_l1_loss

from prbench.errors import TableError, UsageError
from prbench.files.bounded import foreign_input
from prbench.representation.features import JOINT_POSITIONS
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import read_weights, representation_entry, start_from, weights_header
from prbench_benchmarks.motion_tokens.network import FRAMES_OF_TOKEN, Features, Tokeniser, TokeniserConfiguration

KIND = "motion-tokens"


class TokeniserObjective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Keys of ``[model]`` beside those of the networks; defaults are MotionGPT's.

    Attributes:
        window: Frames of a clip.
        windows: Clips drawn from every motion of a batch.
        position: Weight of the error of the joints' positions, which counts beside that of all features.
        commitment: Weight of the distance between the encoder's output and its codes.
    """

    window: int = 64
    windows: int = 1
    position: float = 0.5
    commitment: float = 0.02

    def __post_init__(self) -> None:
        require_within(self, "at least 1", "window", "windows")
        require_within(self, "at least 0", "position", "commitment")
        if self.window % FRAMES_OF_TOKEN:
            raise ValueError(f"`window` must be a multiple of {FRAMES_OF_TOKEN}, found {self.window}")


class TokeniserTraining(TrainingModule):
    """The networks with their losses; the codebooks follow in each step of training.

    Args:
        network: Networks in their state before the first step, with the statistics of the features.
        objective: Clips, and weights of the losses.
        origin: Lines for the card.
    """

    def __init__(self, network: Tokeniser, objective: TokeniserObjective, origin: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.network, self.objective, self.origin = network, objective, origin

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Return ``loss``, its parts ``feature``, ``position`` and ``commitment``, and the codes' ``perplexity``.

        Raises:
            TableError: if a motion is shorter than a token.
        """
        generator = self.generator(step)
        recorded = (self._clips(batch, generator) - self.network.mean) / self.network.std
        reconstructed, quantised = self.network(recorded, generator)
        places = [reconstructed[..., JOINT_POSITIONS], recorded[..., JOINT_POSITIONS]]
        parts = {"feature": smooth_l1_loss(reconstructed, recorded), "position": smooth_l1_loss(*places)}
        parts["commitment"] = quantised.commitment
        loss = parts["feature"] + self.objective.position * parts["position"]
        loss = loss + self.objective.commitment * parts["commitment"]
        return {"loss": loss, **parts, "perplexity": quantised.perplexity}

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Return networks, codebooks with their running sums and counts, and statistics as one object."""
        tensors = {f"network.{name}": tensor for name, tensor in self.network.state_dict().items()}
        sizes = self.network.configuration
        return tensors, weights_header(KIND, sizes, representation_entry(sizes.representation))

    def _clips(self, batch: MotionBatch, generator: torch.Generator) -> Features:
        """Draw clips of one length: a window, or the shortest motion of the batch, never padding.

        Features are seen from the body's own heading, so a part of a motion's rows is a motion.
        """
        shortest = int(batch.n_frames.argmin())
        frames = min(self.objective.window, int(batch.n_frames[shortest])) // FRAMES_OF_TOKEN * FRAMES_OF_TOKEN
        if not frames:
            found = f"found {int(batch.n_frames[shortest])}. Leave the motion out."
            raise TableError(f"{batch.sequence_id[shortest]}: expected {FRAMES_OF_TOKEN} frames or more, {found}")
        chances = torch.rand(len(batch), self.objective.windows, generator=generator).to(batch.n_frames.device)
        starts = (chances * (batch.n_frames - frames + 1)[:, None]).long()
        places = starts[..., None] + torch.arange(frames, device=starts.device)
        rows = torch.arange(len(batch), device=starts.device)[:, None, None]
        return batch.features[rows, places].flatten(0, 1)


@dataclass(frozen=True)
class TokeniserTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name: str = KIND
    configurations: str = "prbench_benchmarks.motion_tokens.configurations"
    stages: tuple[str, ...] = ("train",)

    def build(
        self,
        model: Mapping[str, Any],
        *,
        data: TrainingData,
        initial: Path | None,
        stage: str,  # noqa: ARG002
    ) -> TokeniserTraining:
        """Make the networks in their state before the first step, or in that of weights to go on from.

        Args:
            model: Keys of :class:`TokeniserConfiguration` and of :class:`TokeniserObjective`.
            data: The training split.
            initial: Weights of the same configuration, whose statistics are kept.
            stage: ``train``.

        Raises:
            UsageError: if the table does not describe a tokeniser, or several processes would train it.
            InputFileError: if the initial weights do not fit it.
        """
        sizes, objective = split_model_table(model, TokeniserConfiguration, TokeniserObjective)
        data.require_fit("the tokeniser", sizes)
        if torch.distributed.is_initialized() and torch.distributed.get_world_size() > 1:
            raise UsageError("motion-tokens trains in one process, which sees every vector of a code. Use --devices 1.")
        network = Tokeniser(sizes)
        origin = start_from(initial, KIND, sizes, network)
        if initial is None:
            statistics = data.train.statistics()
            network.mean.copy_(torch.from_numpy(statistics.mean))
            network.std.copy_(torch.from_numpy(statistics.std))
        return TokeniserTraining(network, objective, origin)


@foreign_input()
def load_tokeniser(path: Path, *, device: str = "cpu") -> tuple[Tokeniser, str]:
    """Read a trained tokeniser, and the SHA-256 of its file.

    Raises:
        InputFileError: if the file is none of a tokeniser.
        AdapterError: if there is no such device.
    """
    where = torch_device(device)
    weights = read_weights(path, kind=KIND)
    network = Tokeniser(weights.configuration(TokeniserConfiguration))
    weights.require_representation(network.configuration.representation)
    weights.load_into(network, "network")
    return network.eval().requires_grad_(False).to(where), weights.digest
