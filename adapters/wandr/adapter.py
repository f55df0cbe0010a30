"""The method ``wandr``: initial state and object location in, motion out.

Motions are rolled out frame after frame: intentions, a draw, a change (docs/specification/wandr.md#inference).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, cast, get_args

import numpy as np
import torch
from jaxtyping import Bool, Float, Int

from prbench.contract import Condition, ConditionBatch, Cost, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import Joint
from prbench.randomness import sequence_generator
from prbench.representation import check_joints, mirror
from prbench_adapters.diffusion.generation import choice, number, require_known
from prbench_adapters.diffusion.method import SingleModelMethod, own_weights, require_goals_within_reach
from prbench_adapters.diffusion.model import torch_device
from prbench_adapters.finishing import Finishing
from prbench_adapters.kinematics import WANDR as WORLD
from prbench_adapters.kinematics import rest_offsets, to_floor
from prbench_adapters.training.weights import read_weights
from prbench_adapters.wandr.network import KIND, BodyState, WandrNetwork, clean_delta, intentions, network_of

Hand = Literal["right", "nearest", "left"]

# Recorded wrists never need more than 0.9. Asked for the 1.5 of its training, a late body bends further than people
# do (docs/methods/wandr.md#why-bodies-fall).
_ASKED_SPEED = 1.0  # metres a second

_MIRRORED = np.array([-1.0, 1.0, 1.0], dtype=np.float32)


@dataclass(frozen=True)
class Start:
    """Start of B sequences, before the first step. World with Z up, metres; one precision throughout.

    Attributes:
        state: The first frame.
        delta: The change that led to it.
        offsets: The skeletons at rest.
        goal: Place of the right wrist in the last frame.
        n_frames: Frames of each sequence, the first among them.
    """

    state: BodyState
    delta: Float[torch.Tensor, "batch 135"]
    offsets: Float[torch.Tensor, "batch 22 3"]
    goal: Float[torch.Tensor, "batch 3"]
    n_frames: Int[torch.Tensor, " batch"]


class WANDR(SingleModelMethod):
    """Moves a body frame by frame, so that its wrist is at the goal in the last one.

    Args:
        network: The network, in evaluation mode.
        weights: The file that it came from.
        hand: Hand that reaches. The network knows right ones only: for left ones body and goal are mirrored, and the
            motion back. ``nearest`` takes the one that is nearer to the goal in the first frame.
        most_speed: Longest intention of the wrist, metres a second, infinity for no limit; None for 1 m/s, or for no
            limit if the network was trained without one.
        feet: True keeps a foot on the floor in each step, and lets feet stand or swing at the end.
    """

    name = "wandr"
    conditions = frozenset({Condition.GOAL_LOCATION})

    def __init__(
        self,
        network: WandrNetwork,
        weights: Path,
        *,
        hand: Hand = "right",
        most_speed: float | None = None,
        feet: bool = False,
    ) -> None:
        super().__init__(network, weights, None)
        self.network, self.hand, self.most_speed, self.feet = network, hand, most_speed, feet

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - each row has its own
        """Generate one motion for each row.

        Raises:
            AdapterError: for a goal that no body can reach, or another frame rate than the network's.
            InputFileError: for poses that are no bodies.
        """
        if batch.fps != self.native_fps:
            raise AdapterError(f"wandr: expected {self.native_fps:g} frames per second, found {batch.fps:g}.")
        for name in ("initial_joints", "previous_joints"):
            check_joints(getattr(batch, name), source=name, min_frames=0, upright=False)
        require_goals_within_reach(batch, adapter=self.name)
        assert batch.initial_joints is not None
        assert batch.goal_location is not None
        left = np.full(len(batch), self.hand == "left")
        if self.hand == "nearest":
            wrists = batch.initial_joints[:, [Joint.LEFT_WRIST, Joint.RIGHT_WRIST]]
            distance = np.linalg.norm(wrists - batch.goal_location[:, None], axis=-1)
            left = distance[:, 0] < distance[:, 1]
        most_speed = self.most_speed
        if most_speed is None:
            limit = self.network.configuration.speed_limit
            most_speed = limit if math.isinf(limit) else min(limit, _ASKED_SPEED)
        start, noise = self._start(_mirrored_where(left, batch))
        rolled = roll_out(self.network, start, noise, most_speed, on_floor=self.feet)
        joints = WORLD.to_y_up(rolled).float().cpu().numpy()
        joints[left] = mirror(joints[left])
        # Fitting rotations and mirroring round; the first frame is given, to the bit.
        joints[:, 0] = batch.initial_joints
        motions = Motions(joints, batch.n_frames, Cost(int((batch.n_frames - 1).sum())))
        return Finishing(bones=False, feet=self.feet)(motions, batch)

    def _start(self, batch: ConditionBatch) -> tuple[Start, Float[torch.Tensor, "batch steps latent"]]:
        """Return the start of each row, and the noise of all its steps.

        Each row draws from its own seed: a row's length and the other rows leave no trace in it.
        """
        like = self.network.delta.mean

        def tensor(values: np.ndarray | None) -> torch.Tensor:
            return torch.as_tensor(values, dtype=like.dtype, device=like.device)

        initial, previous, goal = (
            WORLD.from_y_up(tensor(points))
            for points in (batch.initial_joints, batch.previous_joints, batch.goal_location)
        )
        size = self.network.configuration.latent
        latents = np.zeros((len(batch), int(batch.n_frames.max()) - 1, size))
        for row, (seed, n) in enumerate(zip(batch.noise_seed, batch.n_frames, strict=True)):
            generator = sequence_generator(seed)
            generator.standard_normal(len(like))  # the original's first change, in whose place the recorded one stands
            # As many as the row needs: the noise of one sequence must not depend on the longest of its batch.
            latents[row, : n - 1] = generator.standard_normal((n - 1, size))
        state = BodyState.fitted(initial)
        delta = BodyState.fitted(previous).delta_to(state)
        n_frames = torch.as_tensor(batch.n_frames, device=goal.device)
        return Start(state, delta, rest_offsets(initial), goal, n_frames), tensor(latents)


def _mirrored_where(left: Bool[np.ndarray, " batch"], batch: ConditionBatch) -> ConditionBatch:
    """Return the batch with the rows of left hands as a mirror shows them."""
    assert batch.goal_location is not None
    shown: dict[str, np.ndarray] = {}
    for name in ("initial_joints", "previous_joints"):
        shown[name] = np.where(left[:, None, None], mirror(getattr(batch, name)), getattr(batch, name))
    goal = np.where(left[:, None], batch.goal_location * _MIRRORED, batch.goal_location)
    return replace(batch, **shown, goal_location=goal)


def load(weights: Path | None, *, options: Mapping[str, str], device: str) -> WANDR:
    """Entry point ``wandr``.

    Options: ``hand`` (right, nearest, left), ``most-speed`` (1 for networks that were trained with a limit; 0 is none,
    as in the original) of the wrist's intention, metres a second, ``feet`` (steps, or predicted as in the original).

    Args:
        weights: File, folder or name of bundled weights; None for ``wandr-small``.
        options: See above.
        device: ``cpu``, ``cuda`` …

    Raises:
        AdapterError: if there is no such device, or no such weights.
        InputFileError: if the file is not one of WANDR.
        ValueError: for options that are unknown or have impossible values.
    """
    require_known(options, ("hand", "most-speed", "feet"))
    most_speed = number(options, "most-speed", 0.0) or math.inf if "most-speed" in options else None
    hand = cast(Hand, choice(options, "hand", get_args(Hand)))
    path = own_weights(WANDR.name, weights)
    where = torch_device(device)
    network = network_of(read_weights(path, kind=KIND)).eval().requires_grad_(False)
    # A motion is hundreds of steps, each on the last one's result; in double precision what rounding adds stays below
    # a micrometre, whatever the batch.
    network = network.to(where, torch.float32 if where.type == "mps" else torch.float64)
    return WANDR(network, path, hand=hand, most_speed=most_speed, feet=Finishing.of(options).feet)


@torch.no_grad()
def roll_out(
    network: WandrNetwork,
    start: Start,
    noise: Float[torch.Tensor, "batch steps latent"],
    most_speed: float = math.inf,
    *,
    on_floor: bool = False,
) -> Float[torch.Tensor, "batch frames 22 3"]:
    """Joints of all frames; those behind a sequence's own number of frames are padding.

    Args:
        network: The network, in evaluation mode, in the precision of ``start``.
        start: States that the sequences begin with, and their goals.
        noise: Standard normal: the latent of each step.
        most_speed: Longest intention of the wrist, metres a second.
        on_floor: Bring the lower toe back to the floor in each step. Without it errors of the height add up, and bodies
            go on in the air.
    """
    state = start.state
    delta = start.delta
    joints = [state.joints(start.offsets)]
    for step in range(noise.shape[1]):
        intention = intentions(
            state.yaw,
            wrist=joints[-1][:, Joint.RIGHT_WRIST],
            pelvis=joints[-1][:, Joint.PELVIS],
            goal=start.goal,
            # Padding goes on as in its last frame.
            frames_left=(start.n_frames - 1 - step).clamp_min(1)[:, None].to(start.goal),
            fps=network.configuration.fps,
            most_speed=most_speed,
        )
        decoded = network.decode(noise[:, step], network.condition(state.seen(), delta, intention))
        delta = clean_delta(network.delta.undone(decoded))
        state = state.changed(delta)
        if on_floor:
            state = replace(state, pelvis=state.pelvis + to_floor(state.joints(start.offsets), joints[0]))
        joints.append(state.joints(start.offsets))
    return torch.stack(joints, 1)
