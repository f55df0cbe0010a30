"""The network of gaze: one direction a frame, drawn from a mixture that knows where the eyes were before.

Eyes rest and jump. A network that is trained for the mean direction answers with places between two jumps, at which
nobody looks. This one predicts a distribution, a mixture of von Mises-Fisher distributions on the sphere, and one
direction is drawn from it a frame: about the last one (eyes rest in the room while the head turns), about the goal, or
about places that the network names itself. Everything is seen in the frame of the head.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench.geometry.skeleton import BONES, WRISTS, Joint
from prbench_adapters.diffusion.goal_frame import head_axes
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.training.weights import read_weights, weights_header

KIND = "gaze"
_REPRESENTATION = "head-frame"
_PARENTS, _CHILDREN = (list(ends) for ends in zip(*BONES, strict=True))
_OFFSETS = (-16, -8, -4, -2, -1, 1, 2, 4, 8, 16)
"""Frames before and after one whose head directions its features hold: eyes lead the head, so the future matters."""
_PERIODS = (1.0, 2.0, 4.0, 8.0, 16.0)  # seconds; sine and cosine of the time since the first frame
_CLOCK = 4.0  # seconds: the time left is told up to three times this
_CENTRES = 17
_APART = 0.25  # seconds from one to the next; bumps over the first four seconds, in which people look at the goal
_LAGS = (1, 2, 3, 4, 8, 16, 32)
"""Frames ago whose directions the network is told; trackers of ten samples a second spread a jump over three frames."""
_ON_GOAL = math.cos(math.radians(15))
_LONGEST_SINCE = 80  # frames since the eyes were at the goal, or never
_FREE = 3
"""Components whose means are directions that the network names itself."""
_COMPONENTS = 2 + _FREE
"""About the last direction, about the goal, and the free ones."""
_PARAMETERS = 5  # of a component: weight, shift of the mean (3), concentration
_LARGEST_CONCENTRATION = 2e4  # a deviation of 0.4 degrees, about the noise of an eye tracker
_SHORTEST = 1e-6
N_FEATURES = 3 + 1 + 3 * len(_OFFSETS) + 3 + 6 + 1 + 2 * len(_PERIODS) + _CENTRES + 2 + len(BONES)
N_HISTORY = 4 * len(_LAGS) + 1


class GazeConfiguration(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Sizes of the network.

    Raises:
        ValueError: for sizes that are not possible.
    """

    width: int = 128
    """Numbers in its hidden layers."""
    fps: float = 20.0

    def __post_init__(self) -> None:
        if self.width < 1:
            raise ValueError(f"'width' must be at least 1, found {self.width}")
        if not self.fps > 0:
            raise ValueError(f"'fps' must be positive, found {self.fps}")


@dataclass(frozen=True)
class Seen:
    """What the network is told of motions, frame by frame, in the frame of the head."""

    features: Float[Tensor, "batch frames features"]
    axes: Float[Tensor, "batch frames 3 3"]
    """Rows are the unit axes of the head in the motion's frame: left, neck to head, and the forward one of both."""
    goal: Float[Tensor, "batch frames 3"]
    """Unit direction from the head joint to the goal, in the frame of the head."""
    head: Float[Tensor, "batch frames 3"]
    """The head joint, in the motion's frame, metres."""
    lengths: Float[Tensor, "batch 21"]
    """Of the bones in the first frame, metres."""

    @classmethod
    def of(
        cls,
        joints: Float[Tensor, "batch frames 22 3"],
        n_frames: Int[Tensor, " batch"],
        goal: Float[Tensor, "batch 3"],
        fps: float,
    ) -> Seen:
        """Look at motions.

        Args:
            joints: Any frame with Y up, metres; padding may hold anything finite.
            n_frames: Valid frames of each motion.
            goal: Place that is reached, same frame.
            fps: Frames per second.
        """
        forward, up = head_axes(joints)
        left = torch.linalg.cross(up, forward)
        axes = torch.stack((left, up, forward), dim=-2)
        head = joints[:, :, Joint.HEAD]
        to_goal = goal[:, None] - head
        distance = to_goal.norm(dim=-1, keepdim=True).clamp_min(_SHORTEST)
        seen_goal = turned(axes, to_goal / distance)
        frame = torch.arange(joints.shape[1], device=joints.device)
        last = n_frames[:, None] - 1
        row = torch.arange(len(joints), device=joints.device)[:, None]
        parts = [seen_goal, distance.log()]
        for offset in _OFFSETS:
            # Beyond its ends a motion is taken to stand still.
            other = torch.minimum((frame + offset).clamp_min(0)[None], last)
            parts.append(turned(axes, forward[row, other]))
        ahead = torch.minimum((frame + 4)[None], last)
        parts.append(turned(axes, head[row, ahead] - head))
        wrists = joints[:, :, WRISTS]
        parts += [turned(axes, wrists[:, :, side] - head) for side in range(2)]
        parts.append((wrists - goal[:, None, None]).norm(dim=-1).amin(dim=-1, keepdim=True))
        seconds = (frame / fps).to(joints).expand(joints.shape[:2])
        phases = [seconds * (2 * math.pi / period) for period in _PERIODS]
        parts += [torch.stack((phase.sin(), phase.cos()), dim=-1) for phase in phases]
        centres = torch.arange(_CENTRES, device=joints.device) * _APART
        parts.append((-((seconds[..., None] - centres) / _APART).square()).exp())
        seconds_left = ((last - frame) / fps).to(joints).clamp(0.0, 3 * _CLOCK)
        parts.append(torch.stack((seconds_left / _CLOCK, (-seconds_left).exp()), dim=-1))
        first = joints[:, 0]
        lengths = (first[:, _CHILDREN] - first[:, _PARENTS]).norm(dim=-1)
        parts.append(lengths[:, None].expand(-1, joints.shape[1], -1))
        return cls(torch.cat(parts, dim=-1), axes, seen_goal, head, lengths)

    def frames(self, chosen: slice) -> Seen:
        """Some consecutive frames."""
        return Seen(
            self.features[:, chosen], self.axes[:, chosen], self.goal[:, chosen], self.head[:, chosen], self.lengths
        )


def on_goal(direction: Float[Tensor, "*batch 3"], goal: Float[Tensor, "*batch 3"]) -> Bool[Tensor, "*batch"]:
    """Return True where a direction is within 15 degrees of that of the goal."""
    return (direction * goal).sum(dim=-1) > _ON_GOAL


def turned(axes: Float[Tensor, "*batch 3 3"], vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Vectors of the motion's frame in the frame of the head."""
    return (axes @ vectors[..., None])[..., 0]


def turned_back(axes: Float[Tensor, "*batch 3 3"], vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Vectors of the frame of the head in the motion's frame."""
    return (axes.transpose(-1, -2) @ vectors[..., None])[..., 0]


@dataclass(frozen=True)
class Mixture:
    """A distribution of directions for each place: a mixture of von Mises-Fisher distributions."""

    log_weight: Float[Tensor, "*batch components"]
    mean: Float[Tensor, "*batch components 3"]
    """Unit vectors."""
    concentration: Float[Tensor, "*batch components"]

    def log_density(self, direction: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
        """Logarithm of the density of unit directions, by solid angle."""
        kappa = self.concentration
        # Half the squared chord is 1 - cosine, exact for small angles, where the cosine loses its digits.
        fall = (direction[..., None, :] - self.mean).square().sum(dim=-1) / 2
        normaliser = kappa.log() - math.log(2 * math.pi) - torch.log1p(-(-2 * kappa).exp())
        return torch.logsumexp(self.log_weight + normaliser - kappa * fall, dim=-1)

    def drawn(self, noise: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """Draw one direction each.

        Args:
            noise: Independent uniform numbers in [0, 1): they choose the component, the angle from its mean, and the
                way in which it lies.
        """
        below = self.log_weight.exp().cumsum(dim=-1) < noise[..., :1]
        component = below.sum(dim=-1).clamp_max(_COMPONENTS - 1)[..., None]
        mean = self.mean.gather(-2, component[..., None].expand(*component.shape, 3))[..., 0, :]
        kappa = self.concentration.gather(-1, component)[..., 0]
        # Inverse of the distribution of the cosine; Wood's rejection is not needed on the sphere in three dimensions.
        share = noise[..., 1]
        cosine = 1 + torch.log(share + (1 - share) * (-2 * kappa).exp()).clamp_min(-1e3) / kappa
        cosine = cosine.clamp(-1.0, 1.0)
        way = 2 * math.pi * noise[..., 2]
        aside, across = _orthogonal(mean)
        tangent = way.cos()[..., None] * aside + way.sin()[..., None] * across
        sine = (1 - cosine.square()).clamp_min(0.0).sqrt()
        return _unit(cosine[..., None] * mean + sine[..., None] * tangent)


@dataclass(frozen=True)
class History:
    """Where the eyes were before, frame by frame, in the frame of the head of each frame."""

    numbers: Float[Tensor, "batch frames history"]
    last: Float[Tensor, "batch frames 3"]
    """Direction of the frame before; head-forward where there was none."""

    @classmethod
    def of(
        cls,
        seen: Seen,
        directions: Float[Tensor, "batch whole 3"],
        was_on_goal: Bool[Tensor, "batch whole"],
        first: int,
    ) -> History:
        """Look back from each frame of ``seen``.

        Args:
            seen: Frames of motions from number ``first`` on.
            directions: Unit vectors of whole motions in the motion's frame; those of later frames do not matter.
            was_on_goal: Whether the eyes were at the goal, likewise.
            first: Number of the first frame of ``seen``.
        """
        frame = torch.arange(first, first + seen.goal.shape[1], device=directions.device)
        ahead = seen.goal.new_tensor((0.0, 0.0, 1.0)).expand_as(seen.goal)
        last = ahead
        parts = []
        for lag in _LAGS:
            known = (frame >= lag)[None, :, None].expand_as(seen.goal)
            looked = turned(seen.axes, directions[:, (frame - lag).clamp_min(0)])
            looked = torch.where(known, looked, ahead)
            last = looked if lag == 1 else last
            parts += [looked, known[..., :1].to(looked)]
        numbers = torch.arange(directions.shape[1], device=directions.device)
        latest = torch.where(was_on_goal, numbers, -_LONGEST_SINCE).cummax(dim=1).values
        latest = functional.pad(latest, (1, 0), value=-_LONGEST_SINCE)[:, frame]
        since = (frame - latest).clamp_max(_LONGEST_SINCE) / _LONGEST_SINCE
        parts.append(since[..., None].to(seen.goal))
        return cls(torch.cat(parts, dim=-1), last)


class GazeNetwork(nn.Module):
    """Distributions of the gaze direction, frame after frame, and where the eyes are in the head."""

    def __init__(self, configuration: GazeConfiguration) -> None:
        super().__init__()
        self.configuration = configuration
        width = configuration.width
        self.answer = nn.Sequential(
            nn.Linear(N_FEATURES + N_HISTORY, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, width),
            nn.SiLU(),
            nn.Linear(width, _COMPONENTS * _PARAMETERS),
        )
        self.eye = nn.Linear(len(BONES), 3)
        """From the bone lengths to the middle of the eyes in the frame of the head, from the head joint, metres."""

    def forward(self, seen: Seen, history: History) -> Mixture:
        """Distributions of each frame's direction, in the frame of its head."""
        ahead = seen.goal.new_tensor((0.0, 0.0, 1.0)).expand_as(seen.goal)
        numbers = self.answer(torch.cat((seen.features, history.numbers), dim=-1))
        numbers = numbers.unflatten(-1, (_COMPONENTS, _PARAMETERS))
        anchors = torch.stack((history.last, seen.goal, *[ahead] * _FREE), dim=-2)
        concentration = (1 + functional.softplus(numbers[..., 4]) ** 4).clamp_max(_LARGEST_CONCENTRATION)
        return Mixture(numbers[..., 0].log_softmax(dim=-1), _unit(anchors + numbers[..., 1:4]), concentration)

    def eyes(self, seen: Seen) -> Float[Tensor, "batch frames 3"]:
        """The middle between the eyes, in the motion's frame, metres."""
        return seen.head + turned_back(seen.axes, self.eye(seen.lengths)[:, None].expand_as(seen.head))

    def sampled(self, seen: Seen, noise: Float[Tensor, "batch frames 3"]) -> Float[Tensor, "batch frames 3"]:
        """Draw the directions of whole motions, frame after frame.

        Args:
            seen: The motions.
            noise: Uniform numbers in [0, 1), see :meth:`Mixture.drawn`.

        Returns:
            Unit directions in the motion's frame.
        """
        directions = torch.zeros_like(seen.goal)
        was_on_goal = torch.zeros_like(directions[..., 0], dtype=torch.bool)
        for frame in range(seen.goal.shape[1]):
            here = slice(frame, frame + 1)
            now = seen.frames(here)
            drawn = self(now, History.of(now, directions, was_on_goal, frame)).drawn(noise[:, here])
            directions[:, here] = _unit_or_ahead(turned_back(now.axes, drawn))
            was_on_goal[:, here] = on_goal(drawn, now.goal)
        return directions


def contents(network: GazeNetwork) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Tensors and header entries of a network."""
    header = weights_header(KIND, network.configuration, _REPRESENTATION)
    return {f"network.{name}": tensor for name, tensor in network.state_dict().items()}, header


def load_network(path: Path, device: str) -> GazeNetwork:
    """Load a frozen network in double precision, where the device has that.

    Each direction is drawn about the last one. In double precision the batch around a row does not decide what is
    drawn.

    Raises:
        AdapterError: if there is no such device.
        InputFileError: if the file holds no weights of this kind, or misshaped ones.
    """
    where = torch_device(device)
    weights = read_weights(path, kind=KIND)
    network = GazeNetwork(weights.configuration(GazeConfiguration))
    weights.load_into(network, "network")
    network = network.eval().requires_grad_(False)
    return network.to(where, torch.float32 if where.type == "mps" else torch.float64)


def _unit(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    return vectors / vectors.norm(dim=-1, keepdim=True).clamp_min(_SHORTEST)


def _unit_or_ahead(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """Unit vectors; +Z where a body without shoulders or neck has no axes to look along."""
    length = vectors.norm(dim=-1, keepdim=True)
    ahead = vectors.new_tensor((0.0, 0.0, 1.0)).expand_as(vectors)
    return torch.where(length > _SHORTEST, vectors / length.clamp_min(_SHORTEST), ahead)


def _orthogonal(unit: Float[Tensor, "*batch 3"]) -> tuple[Float[Tensor, "*batch 3"], Float[Tensor, "*batch 3"]]:
    """Return two unit vectors that are orthogonal to a unit vector and to one another."""
    flat = unit[..., 1:2].abs() < 0.9  # Y is far enough from the vector
    other = torch.where(flat, unit.new_tensor((0.0, 1.0, 0.0)), unit.new_tensor((1.0, 0.0, 0.0)))
    aside = _unit(torch.linalg.cross(other.expand_as(unit), unit))
    return aside, torch.linalg.cross(unit, aside)
