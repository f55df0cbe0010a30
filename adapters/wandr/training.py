"""Training of WANDR: each recorded change by itself, and chunks of changes on the network's own output."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Literal

import msgspec
import torch
from jaxtyping import Float, Int

from prbench.contract import Adapter
from prbench.geometry.skeleton import Joint
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.task import TrainingModule
from prbench_adapters.wandr.adapter import WANDR
from prbench_adapters.wandr.network import WandrNetwork, contents
from prbench_adapters.wandr.recordings import Places, Recordings, goal_frames, starts
from prbench_adapters.wandr.state import JOINTS, ROOT, TRANSLATION, BodyState, clean_delta, intentions

_CENTIMETRES = 100.0


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, and the training on the network's own output; the defaults are those of the original."""

    kl_weight: float = 1e-2
    free_bits: float = 0.05
    """Below this, the divergence of a dimension is not pushed down any further."""
    joint_loss_weight: float = 1.0
    """Weight of the squared error of the joints, square centimetres."""
    longest_chunk: int = 10
    """Frames that the network runs on its own output at most."""
    steps_per_chunk_frame: int = 1000
    """Training steps after which chunks may be one frame longer (the original: five epochs)."""
    own_latents: Literal["encoded", "drawn"] = "encoded"
    """Source of the latents of chunks: the encoder, which sees the change that is wanted, as in the original, or
    the standard normal distribution, as in generation. What corrects a body that has strayed may come from the encoder
    in the first case; generation has none. In the second it must come from state and goal."""
    frames_per_step: int = 0
    """Number of frames of a batch that are drawn for a step, and as many for the network's own output; 0 takes all."""
    frames_back: int = 1
    """Frames in which a body that has strayed in a chunk is to be back at the recording. 1 is the original's: the whole
    way back within one frame, which is a leap once a chunk is long. With more, the wanted change is the recorded one
    with so small a part of the way back."""
    pseudo_goals: float = 0.0
    """Share of the frames of motions with a goal that are shown a pseudo goal instead, as the original's AMASS has
    beside the goals of CIRCLE."""

    def __post_init__(self) -> None:
        for name in ("kl_weight", "free_bits", "joint_loss_weight", "frames_per_step"):
            if getattr(self, name) < 0:
                raise ValueError(f"'{name}' must be at least 0, found {getattr(self, name)}")
        for name in ("longest_chunk", "steps_per_chunk_frame", "frames_back"):
            if getattr(self, name) < 1:
                raise ValueError(f"'{name}' must be at least 1, found {getattr(self, name)}")
        if not 0 <= self.pseudo_goals <= 1:
            raise ValueError(f"'pseudo_goals' must be between 0 and 1, found {self.pseudo_goals}")


def delta_loss(
    decoded: Float[torch.Tensor, "places 135"], wanted: Float[torch.Tensor, "places 135"]
) -> Float[torch.Tensor, ""]:
    """Mean squared errors of standardised changes: translation, root and joints each for themselves, summed."""
    error = (decoded - wanted).square()
    return sum((error[:, part].mean() for part in (TRANSLATION, ROOT, JOINTS)), error.new_zeros(()))


def joint_loss(
    predicted: Float[torch.Tensor, "places 22 3"], recorded: Float[torch.Tensor, "places 22 3"]
) -> Float[torch.Tensor, ""]:
    """Mean squared error of coordinates, square centimetres."""
    return ((predicted - recorded) * _CENTIMETRES).square().mean()


def divergence(
    mean: Float[torch.Tensor, "places latent"], log_variance: Float[torch.Tensor, "places latent"], free_bits: float
) -> Float[torch.Tensor, ""]:
    """Mean over dimensions of the divergence from a standard normal distribution, each at least ``free_bits``."""
    each = 0.5 * (mean.square() + log_variance.exp() - log_variance - 1)
    return each.clamp_min(free_bits).mean()


class WandrTraining(TrainingModule):
    """A network with its losses.

    Args:
        network: In its state before the first step, with statistics.
        objective: Weights of the losses.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(self, network: WandrNetwork, objective: Objective, origin: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.network, self.objective, self.origin = network, objective, origin

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """The loss of one batch, and its parts.

        Returns:
            ``loss``; ``changes``, ``divergence`` and ``positions`` (square centimetres) of single changes, unweighted;
            ``own_changes`` and ``own_positions`` of chunks, 0 in steps without.
        """
        with torch.autocast(batch.joints.device.type, enabled=False):  # rotations and positions add up: float32 only
            generator = self.generator(step)
            recordings = Recordings.of(batch, self.network.configuration.fps)
            length = self.chunk_length(step, generator)
            losses = self._single_changes(recordings, generator) | self._chunks(recordings, length, generator)
            objective = self.objective
            weights = {"divergence": objective.kl_weight}
            weights |= dict.fromkeys(("positions", "own_positions"), objective.joint_loss_weight)
            total = torch.stack([weights.get(name, 1.0) * value for name, value in losses.items()]).sum()
            return {"loss": total, **{name: value.detach() for name, value in losses.items()}}

    def chunk_length(self, step: int, generator: torch.Generator) -> int:
        """Frames that the network runs on its own output in a step: from 0 to a number that grows; 0 in validation."""
        # Chunks grow with the training: an untrained network would stray within a few frames.
        longest = min(self.objective.longest_chunk, max(step, 0) // self.objective.steps_per_chunk_frame)
        return int(torch.randint(longest + 1, (), generator=generator))

    def _single_changes(self, recordings: Recordings, generator: torch.Generator) -> dict[str, torch.Tensor]:
        places = starts(recordings, 1).some(self.objective.frames_per_step, generator)
        before, state, after = (recordings.states(places.later(frames)) for frames in (-1, 0, 1))
        condition = self._condition(
            recordings,
            places,
            self._goal_frames(recordings, places, generator),
            state,
            delta=before.delta_to(state),
            joints=recordings.joints[places.index],
        )
        wanted = self.network.delta(state.delta_to(after))
        decoded, mean, log_variance = self._reconstructed(wanted, condition, generator)
        following = state.changed(self.network.delta.undone(decoded))
        moved = following.joints(recordings.offsets[places.row])
        return {
            "changes": delta_loss(decoded, wanted),
            "divergence": divergence(mean, log_variance, self.objective.free_bits),
            "positions": joint_loss(moved, recordings.joints[places.later(1).index]),
        }

    def _chunks(self, recordings: Recordings, length: int, generator: torch.Generator) -> dict[str, torch.Tensor]:
        """Chunks of so many changes, each from where the one before has led; wanted is what leads to the recording."""
        places = starts(recordings, max(length, 2)).some(
            -(-self.objective.frames_per_step // max(length, 2)), generator
        )
        if length < 2 or not len(places.row):  # none in this step, or all motions are shorter
            return dict.fromkeys(("own_changes", "own_positions"), recordings.joints.new_zeros(()))
        goals = self._goal_frames(recordings, places, generator)
        state = recordings.states(places)
        delta = recordings.states(places.later(-1)).delta_to(state)
        joints = recordings.joints[places.index]
        offsets = recordings.offsets[places.row]
        recorded = recordings.states(places.following(length))
        before = recordings.states(places)
        changes = []
        positions = []
        for step in range(length):
            here = places.later(step)
            # From the network's own state, so that it learns to come back from where it strayed.
            condition = self._condition(recordings, here, goals, state, delta=delta, joints=joints)
            target = recordings.joints[here.later(1).index]
            back = state.delta_to(recorded[:, step])
            if self.objective.frames_back > 1:
                # Rotations of one frame are so small that a part of their numbers is a part of the turn.
                back = torch.lerp(before.delta_to(recorded[:, step]), back, 1 / self.objective.frames_back)
                target = state.changed(back).joints(offsets).detach()
                before = recorded[:, step]
            wanted = self.network.delta(back)
            decoded = self._own_change(wanted, condition, generator)
            delta = clean_delta(self.network.delta.undone(decoded))
            state = state.changed(delta)
            joints = state.joints(offsets)
            changes.append(delta_loss(decoded, wanted))
            positions.append(joint_loss(joints, target))
        return {"own_changes": torch.stack(changes).mean(), "own_positions": torch.stack(positions).mean()}

    def _goal_frames(
        self, recordings: Recordings, places: Places, generator: torch.Generator
    ) -> Int[torch.Tensor, " places"]:
        return goal_frames(recordings, places, generator, pseudo_share=self.objective.pseudo_goals)

    def _condition(
        self,
        recordings: Recordings,
        places: Places,
        goals: Int[torch.Tensor, " places"],
        state: BodyState,
        *,
        delta: Float[torch.Tensor, "places 135"],
        joints: Float[torch.Tensor, "places 22 3"],
    ) -> Float[torch.Tensor, "places 277"]:
        """Encode what the network is told; the goal is where the right wrist will be in the goal's frame.

        Args:
            recordings: The recordings.
            places: The frames that these are.
            goals: Frames of their goals; at the goal and after it nothing is intended.
            state: The bodies there, recorded or the network's own.
            delta: Changes that led to them.
            joints: Of the states.
        """
        left = (goals - places.frame)[:, None]
        intention = intentions(
            state.yaw,
            wrist=joints[:, Joint.RIGHT_WRIST],
            pelvis=joints[:, Joint.PELVIS],
            goal=recordings.joints[places.row, goals, Joint.RIGHT_WRIST],
            frames_left=left.clamp_min(1).to(joints),
            fps=self.network.configuration.fps,
            goal_heading=recordings.headings[places.row, goals],
            most_speed=self.network.configuration.speed_limit,
        )
        return self.network.condition(state.seen(), delta, torch.where(left > 0, intention, 0.0))

    def _reconstructed(
        self,
        wanted: Float[torch.Tensor, "places 135"],
        condition: Float[torch.Tensor, "places 277"],
        generator: torch.Generator,
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Decode a draw from the encoder; return also the mean and log-variance of that."""
        mean, log_variance = self.network.encode(wanted, condition)
        noise = torch.randn(mean.shape, generator=generator).to(mean)
        return self.network.decode(self.network.draw(mean, log_variance, noise), condition), mean, log_variance

    def _own_change(self, wanted: torch.Tensor, condition: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """The change that a chunk goes on with, standardised."""
        if self.objective.own_latents == "encoded":
            return self._reconstructed(wanted, condition, generator)[0]
        latent = torch.randn(len(condition), self.network.configuration.latent, generator=generator)
        return self.network.decode(latent.to(condition), condition)

    def hidden_matrices(self) -> tuple[torch.nn.Parameter, ...]:
        """The matrices of all layers but the first and the last of encoder and decoder."""
        encoder, decoder = (
            [parameter for parameter in stack.parameters() if parameter.ndim == 2]
            for stack in (self.network.encoder, self.network.decoder)
        )
        return (*encoder[1:-1], *decoder[1:-1])

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """The network with its statistics, and the header of its file."""
        return contents(self.network)

    def adapter(self, device: str) -> Adapter:
        """``wandr`` with a copy of the weights as they are now."""
        network = copy.deepcopy(self.network).to(device).eval().requires_grad_(False)
        return WANDR(network if device.startswith("mps") else network.double(), Path("the network in training"))
