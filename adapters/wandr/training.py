"""Training of WANDR: motions in its world and at its rate, the losses of its network, and the task."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import msgspec
import torch
from jaxtyping import Float, Int

from prbench.errors import UsageError
from prbench.geometry.skeleton import Joint
from prbench.protocol.manifests import load_protocol
from prbench.representation.encoding import MIRRORED_JOINTS
from prbench_adapters.diffusion.training import foot_loss, ray_loss
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.kinematics import rest_offsets, root_orientation
from prbench_adapters.training import MotionBatch, collate
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import origin_of, read_weights
from prbench_adapters.wandr import network as wandr

Rows = Int[torch.Tensor, " places"]  # of the feature store
Loss = Float[torch.Tensor, ""]
Changes = Float[torch.Tensor, "places 135"]
Conditions = Float[torch.Tensor, "places 277"]

_FAR = 1.5  # metres that the pelvis has to walk to a pseudo goal
_ROUNDING = 1e-4  # frames


@dataclass(frozen=True)
class Recordings:
    """B recorded motions; frame 0 is the one before the first, frames from ``n_frames[i]`` on are padding.

    Attributes:
        joints: World with Z up, metres.
        goal: Place of the object that the last frame reaches; NaN where there is none and goals are made up
            (:func:`goal_frames`).
    """

    joints: Float[torch.Tensor, "batch frames 22 3"]
    n_frames: Int[torch.Tensor, " batch"]
    goal: Float[torch.Tensor, "batch 3"]

    @classmethod
    def of(cls, batch: MotionBatch, fps: float) -> Recordings:
        """Return the motions of a batch, left-handed ones as a mirror shows them.

        A hand is left if the left wrist is nearer to the goal location in the last frame. Clips of a corpus, which have
        no goal location, stay as they are.
        """
        last = batch.goal_joints
        distance = (last[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]] - batch.goal_location[:, None]).norm(dim=-1)
        # Joints at another rate, on a grid that ends on the last frame and begins before the first; and lengths.
        whole = torch.cat((batch.previous_joints[:, None], batch.joints), dim=1)
        last = batch.n_frames  # the number of the last frame in ``whole``
        # The grid ends on the last frame, because that one reaches the goal; what is left over is cut off in front.
        n_frames = torch.floor(last * (fps / batch.fps) + _ROUNDING).long() + 1
        frames = torch.arange(int(n_frames.max()), device=whole.device)
        place = last[:, None] - (n_frames[:, None] - 1 - frames) * (batch.fps / fps)
        place = torch.minimum(place.clamp_min(0.0), last[:, None])
        left = torch.minimum(torch.floor(place + _ROUNDING).long(), last[:, None])
        right = torch.minimum(left + 1, last[:, None])
        weight = (place - left).clamp(0.0, 1.0)[..., None, None].to(whole.dtype)
        row = torch.arange(len(whole), device=whole.device)[:, None]
        joints = whole[row, left] * (1 - weight) + whole[row, right] * weight
        mirrored = joints[:, :, list(MIRRORED_JOINTS)] * joints.new_tensor((-1.0, 1.0, 1.0))
        left = (distance[:, 0] < distance[:, 1])[:, None]
        goal = torch.where(left, batch.goal_location * joints.new_tensor((-1.0, 1.0, 1.0)), batch.goal_location)
        joints = torch.where(left[..., None, None], mirrored, joints)
        return cls(WORLD.from_y_up(joints), n_frames, WORLD.from_y_up(goal))

    def states(self, places: Places) -> wandr.BodyState:
        """Return the bodies at some places; fitted when asked for, because a step needs few of the frames."""
        return wandr.BodyState.fitted(self.joints[places.index])

    @cached_property
    def headings(self) -> Float[torch.Tensor, "batch frames 3"]:
        """Directions that the bodies face."""
        return wandr.heading_of(wandr.yaw_rotation(root_orientation(self.joints)))

    def deltas(self, places: Places) -> Float[torch.Tensor, "*places 135"]:
        """Return the changes from there to the frames that follow."""
        return self.states(places).delta_to(self.states(places.later(1)))

    @cached_property
    def offsets(self) -> Float[torch.Tensor, "batch 22 3"]:
        """The skeletons at rest, as the first frame has them."""
        return rest_offsets(self.joints[:, 1])


@dataclass(frozen=True)
class Places:
    """Frames of recordings: that of number ``frame[i]`` in recording ``row[i]``."""

    row: Int[torch.Tensor, "*places"]
    frame: Int[torch.Tensor, "*places"]

    @property
    def index(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Index into values of (batch, frames, …)."""
        return self.row, self.frame

    def later(self, frames: int) -> Places:
        """Move all places by the same number of frames."""
        return Places(self.row, self.frame + frames)

    def following(self, frames: int) -> Places:
        """Return the frames that follow each of them: (places, frames)."""
        after = torch.arange(1, frames + 1, device=self.frame.device)
        return Places(self.row[:, None].expand(-1, frames), self.frame[:, None] + after)

    def some(self, most: int, generator: torch.Generator) -> Places:
        """Draw at most so many of them without repetition; keep all if that is 0."""
        if not most or len(self.row) <= most:
            return self
        drawn = torch.randperm(len(self.row), generator=generator)[:most].to(self.row.device)
        return Places(self.row[drawn], self.frame[drawn])


def starts(recordings: Recordings, length: int) -> Places:
    """Every ``length``-th frame from which so many changes follow, the first frame of each motion among them."""
    frames = torch.arange(1, recordings.joints.shape[1], length, device=recordings.joints.device)
    row, number = torch.nonzero(frames + length < recordings.n_frames[:, None], as_tuple=True)
    return Places(row, frames[number])


def goal_frames(
    recordings: Recordings, places: Places, generator: torch.Generator, *, pseudo_share: float = 0.0
) -> Rows:
    """Choose the frame whose wrist position is the goal: the last one, or that of a pseudo goal.

    A pseudo goal is any later frame, all alike, in which the pelvis is 1.5 m or more away. Where there is none it is
    the frame itself, which means that nothing is intended, or the last frame of a motion that has a goal.

    Args:
        recordings: The recordings.
        places: The frames that are on their way.
        generator: Generator of the draws.
        pseudo_share: Share of the places in motions with a goal that get a pseudo goal all the same.
    """
    last = recordings.n_frames[places.row] - 1
    has_goal = torch.isfinite(recordings.goal).all(dim=-1)[places.row]
    pretended = ~has_goal
    if pseudo_share:
        pretended = pretended | (torch.rand(len(last), generator=generator).to(last.device) < pseudo_share)
    if not bool(pretended.any()):
        return last
    pelvis = recordings.joints[:, :, Joint.PELVIS]
    frames = torch.arange(pelvis.shape[1], device=pelvis.device)
    far = (pelvis[places.row] - pelvis[places.index][:, None]).norm(dim=-1) >= _FAR
    possible = far & (frames > places.frame[:, None]) & (frames <= last[:, None])
    # The largest of uniform numbers is uniform among the possible frames; the others get -1 and are never chosen.
    drawn = torch.rand(possible.shape, generator=generator).to(pelvis.device).masked_fill(~possible, -1.0).argmax(1)
    otherwise = torch.where(has_goal, last, places.frame)
    return torch.where(pretended, torch.where(possible.any(dim=1), drawn, otherwise), last)


_CENTIMETRES = 100.0


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The losses, and the training on the network's own output; the defaults are those of the original.

    Attributes:
        free_bits: Below this, the divergence of a dimension is not pushed down any further.
        joint_loss_weight: Weight of the squared error of the joints, square centimetres.
        longest_chunk: Frames that the network runs on its own output at most.
        steps_per_chunk_frame: Training steps after which chunks may be one frame longer (the original: five epochs).
        own_latents: Source of the latents of chunks: the encoder, which sees the change that is wanted, as in the
            original, or the standard normal distribution, as in generation. What corrects a body that has strayed may
            come from the encoder in the first case; generation has none. In the second it must come from state and
            goal.
        frames_per_step: Number of frames of a batch that are drawn for a step, and as many for the network's own
            output; 0 takes all.
        frames_back: Frames in which a body that has strayed in a chunk is to be back at the recording. 1 is the
            original's: the whole way back within one frame, which is a leap once a chunk is long. With more, the wanted
            change is the recorded one with so small a part of the way back.
        pseudo_goals: Share of the frames of motions with a goal that are shown a pseudo goal instead, as the original's
            AMASS has beside the goals of CIRCLE.
        ray_loss_weight: Weight of the miss of the head's axes in chunks
            (:func:`prbench_adapters.diffusion.training.ray_loss`), m²; not in the original.
        foot_loss_weight: Weight of the squared steps of planted toes in chunks, m²; not in the original.
    """

    kl_weight: float = 1e-2
    free_bits: float = 0.05
    joint_loss_weight: float = 1.0
    longest_chunk: int = 10
    steps_per_chunk_frame: int = 1000
    own_latents: Literal["encoded", "drawn"] = "encoded"
    frames_per_step: int = 0
    frames_back: int = 1
    pseudo_goals: float = 0.0
    ray_loss_weight: float = 0.0
    foot_loss_weight: float = 0.0

    def __post_init__(self) -> None:
        require_within(self, "at least 0", "kl_weight", "free_bits", "joint_loss_weight", "frames_per_step")
        require_within(self, "at least 0", "ray_loss_weight", "foot_loss_weight")
        require_within(self, "at least 1", "longest_chunk", "steps_per_chunk_frame", "frames_back")
        require_within(self, "from 0 to 1", "pseudo_goals")


def delta_loss(decoded: Changes, wanted: Changes) -> Loss:
    """Mean squared errors of standardised changes: translation, root and joints each for themselves, summed."""
    error = (decoded - wanted).square()
    return sum((error[:, part].mean() for part in (wandr.TRANSLATION, wandr.ROOT, wandr.JOINTS)), error.new_zeros(()))


def joint_loss(predicted: Float[torch.Tensor, "places 22 3"], recorded: Float[torch.Tensor, "places 22 3"]) -> Loss:
    """Mean squared error of coordinates, square centimetres."""
    return ((predicted - recorded) * _CENTIMETRES).square().mean()


def divergence(
    mean: Float[torch.Tensor, "places latent"], log_variance: Float[torch.Tensor, "places latent"], free_bits: float
) -> Loss:
    """Mean over dimensions of the divergence from a standard normal distribution, each at least ``free_bits``."""
    return (0.5 * (mean.square() + log_variance.exp() - log_variance - 1)).clamp_min(free_bits).mean()


class WandrTraining(TrainingModule):
    """A network with its losses.

    Args:
        network: The network before the first step, with statistics.
        objective: Weights of the losses.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(self, network: wandr.WandrNetwork, objective: Objective, origin: tuple[str, ...] = ()) -> None:
        super().__init__()
        self.network, self.objective, self.origin = network, objective, origin
        scored = {"own_rays": objective.ray_loss_weight, "own_feet": objective.foot_loss_weight}
        self.scored = {name: weight for name, weight in scored.items() if weight}

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Return the loss of one batch, and its parts.

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
            weights |= self.scored
            total = torch.stack([weights.get(name, 1.0) * value for name, value in losses.items()]).sum()
            return {"loss": total, **{name: value.detach() for name, value in losses.items()}}

    def comparable_from(self) -> int:
        """Return the step at which chunks have their full length; validation takes single steps of recorded bodies."""
        return self.objective.longest_chunk * self.objective.steps_per_chunk_frame

    def chunk_length(self, step: int, generator: torch.Generator) -> int:
        """Frames that the network runs on its own output in a step: from 0 to a number that grows; 0 in validation."""
        # Chunks grow with the training: an untrained network would stray within a few frames.
        longest = min(self.objective.longest_chunk, max(step, 0) // self.objective.steps_per_chunk_frame)
        return int(torch.randint(longest + 1, (), generator=generator))

    def _single_changes(self, recordings: Recordings, generator: torch.Generator) -> dict[str, torch.Tensor]:
        places = starts(recordings, 1).some(self.objective.frames_per_step, generator)
        before, state, after = (recordings.states(places.later(frames)) for frames in (-1, 0, 1))
        goals = self._goal_frames(recordings, places, generator)
        joints = recordings.joints[places.index]
        condition = self._condition(recordings, places, goals, state, delta=before.delta_to(state), joints=joints)
        wanted = self.network.delta(state.delta_to(after))
        decoded, mean, log_variance = self._reconstructed(wanted, condition, generator)
        moved = state.changed(self.network.delta.undone(decoded)).joints(recordings.offsets[places.row])
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
            return dict.fromkeys(("own_changes", "own_positions", *self.scored), recordings.joints.new_zeros(()))
        goals = self._goal_frames(recordings, places, generator)
        state = recordings.states(places)
        delta = recordings.states(places.later(-1)).delta_to(state)
        joints = recordings.joints[places.index]
        offsets = recordings.offsets[places.row]
        recorded = recordings.states(places.following(length))
        before = recordings.states(places)
        changes = []
        positions = []
        own = []
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
            if self.objective.own_latents == "encoded":
                decoded = self._reconstructed(wanted, condition, generator)[0]
            else:
                latent = torch.randn(len(condition), self.network.configuration.latent, generator=generator)
                decoded = self.network.decode(latent.to(condition), condition)
            delta = wandr.clean_delta(self.network.delta.undone(decoded))
            state = state.changed(delta)
            joints = state.joints(offsets)
            changes.append(delta_loss(decoded, wanted))
            positions.append(joint_loss(joints, target))
            own.append(joints)
        return {
            "own_changes": torch.stack(changes).mean(),
            "own_positions": torch.stack(positions).mean(),
            **self._scored(recordings, places.following(length), torch.stack(own, dim=1)),
        }

    def _scored(
        self, recordings: Recordings, places: Places, own: Float[torch.Tensor, "places frames 22 3"]
    ) -> dict[str, torch.Tensor]:
        """Return those losses of what the benchmark looks at that have a weight; chunks without a goal have no rays."""
        fps = self.network.configuration.fps
        goal = recordings.goal[places.row[:, 0]]
        valid = torch.isfinite(goal).all(dim=-1, keepdim=True).expand_as(places.frame)
        joints = WORLD.to_y_up(own), WORLD.to_y_up(recordings.joints[places.index])
        parts = {"own_feet": foot_loss(*joints, torch.ones_like(valid), fps)}
        if "own_rays" in self.scored:
            # Frame 1 is the sequence's first, a fixed time before the prime time.
            after_prime = (places.frame - 1) / fps - load_protocol().curation.lead
            parts["own_rays"] = ray_loss(*joints, WORLD.to_y_up(goal).nan_to_num(), valid, after_prime)
        return {name: parts[name] for name in self.scored}

    def _goal_frames(self, recordings: Recordings, places: Places, generator: torch.Generator) -> Rows:
        return goal_frames(recordings, places, generator, pseudo_share=self.objective.pseudo_goals)

    def _condition(
        self,
        recordings: Recordings,
        places: Places,
        goals: Rows,
        state: wandr.BodyState,
        *,
        delta: Changes,
        joints: Float[torch.Tensor, "places 22 3"],
    ) -> Conditions:
        """Encode what the network is told; the goal is where the right wrist will be in the goal's frame.

        Args:
            recordings: The recordings.
            places: The frames that these are.
            goals: Frames of their goals; at the goal and after it nothing is intended.
            state: The bodies there, recorded or the network's own.
            delta: Changes that led to them.
            joints: Joints of the states.
        """
        left = (goals - places.frame)[:, None]
        intention = wandr.intentions(
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
        self, wanted: Changes, condition: Conditions, generator: torch.Generator
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Decode a draw from the encoder; return also the mean and log-variance of that."""
        mean, log_variance = self.network.encode(wanted, condition)
        noise = torch.randn(mean.shape, generator=generator).to(mean)
        return self.network.decode(self.network.draw(mean, log_variance, noise), condition), mean, log_variance

    def hidden_matrices(self) -> tuple[torch.nn.Parameter, ...]:
        """Return the matrices of all layers but the first and the last of encoder and decoder."""
        encoder, decoder = (
            [parameter for parameter in stack.parameters() if parameter.ndim == 2]
            for stack in (self.network.encoder, self.network.decoder)
        )
        return (*encoder[1:-1], *decoder[1:-1])

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Return the network with its statistics, and the header of its file."""
        return wandr.contents(self.network)


# Keys that fine-tuning may set otherwise than the weights that it starts from.
FREE_TO_CHANGE = frozenset({"dropout", "original_deviation", "most_speed"})

# Number of motions that statistics are made from, spread evenly over the training split.
_MOST_MOTIONS = 4096
_TOGETHER = 64
_LEAST_SEEN = 0.02
# Smallest deviations of a state's numbers and of a change's (metres, numbers of a matrix). Some hardly vary, such as a
# hip's rotation in recordings of one person; whatever is a little different later must not look enormous.
_LEAST_DELTA = 1e-3


class WandrTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name = "wandr"
    configurations = "prbench_adapters.wandr"

    def build(self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str) -> WandrTraining:
        """Make the network in its state before the first step.

        Args:
            model: Keys of :class:`WandrConfiguration` and of :class:`Objective`.
            data: The training split; tables with goals, corpora without, or both.
            initial: Weights to start from; their statistics are kept.
            stage: ``pretrain`` or ``finetune``, which differ in their data alone.

        Raises:
            UsageError: if the table does not describe such a network.
            InputFileError: if the initial weights do not fit it.
        """
        del stage  # motions say themselves whether they have goals
        configuration, objective = split_model_table(model, wandr.WandrConfiguration, Objective)
        network = wandr.WandrNetwork(configuration)
        if initial is not None:
            start = read_weights(initial, kind=wandr.KIND)
            start.require_same(configuration, apart_from=FREE_TO_CHANGE)
            # Through a network of the file's own configuration, which checks every shape.
            network.load_state_dict(wandr.network_of(start).state_dict())
            return WandrTraining(network, objective, origin_of(start))
        # Standardise by the training split.
        seen = []
        deltas = []
        train = data.train
        chosen = range(0, len(train), -(-len(train) // _MOST_MOTIONS))
        # Similar lengths together, so that little is computed for padding.
        order = sorted(chosen, key=lambda place: int(train.lengths[place]))
        for first in range(0, len(order), _TOGETHER):
            batch = collate([train[place] for place in order[first : first + _TOGETHER]])
            recordings = Recordings.of(batch, network.configuration.fps)
            places = starts(recordings, 1)
            seen.append(recordings.states(places).seen())
            deltas.append(recordings.deltas(places))
        if not sum(len(values) for values in deltas):
            raise UsageError("the training split: expected motions of three frames or more, found none.")
        _set(network.seen, torch.cat(seen), _LEAST_SEEN)
        _set(network.delta, torch.cat(deltas), _LEAST_DELTA)
        return WandrTraining(network, objective)


def _set(into: wandr.Standardisation, values: Float[torch.Tensor, "places size"], least: float) -> None:
    values = values.double()
    into.mean.copy_(values.mean(0))
    into.std.copy_(values.std(0, correction=0).clamp_min(least))
