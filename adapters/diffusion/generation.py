"""Steps that a batch of conditions takes around a network.

Bodies are put onto the skeleton that a model has learnt and motions back onto the person's; sequences of similar length
share a pass, so that little is computed for padding; each sequence draws its noise from its own seed, with NumPy, so
that it is the same on every device and in every batch.

Models of P&R or Nymeria know bodies with their own bone lengths. Models of HumanML3D know one skeleton only: conditions
are put onto it, goals are scaled with the root, and the motion is scaled back
(docs/specification/pr-model.md#data-and-features). A network predicts positions, so the lengths of its bones waver by
some per cent; with the option ``bones=initial``, which the study does not have, every bone keeps its predicted
direction and takes its length from the initial pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from prbench.contract import ConditionBatch, Cost, Motions
from prbench.errors import AdapterError, did_you_mean
from prbench.geometry.skeleton import N_JOINTS, PARENTS
from prbench.randomness import sequence_generator
from prbench.representation import N_FEATURES, UniformSkeleton
from prbench_adapters.diffusion.configuration import EncodedCondition
from prbench_adapters.diffusion.denoiser import Counts, Network, frame_mask
from prbench_adapters.diffusion.goal_frame import TRAINED_WITH, Joints, bones, unit
from prbench_adapters.diffusion.model import MotionModel
from prbench_adapters.diffusion.sampling import sample_ddim, sample_ddpm

Lengths = Int[np.ndarray, " batch"]  # frames
Features = Float[Tensor, "batch frames features"]

_MOST_PADDING = 0.25  # of the shortest sequence of a part


def parts_of_similar_length(n_frames: Lengths, largest: int) -> list[Int[np.ndarray, " _"]]:
    """Row numbers in parts of at most ``largest``, shortest sequences first.

    A part ends early where the next sequence would make the shortest one carry a quarter of its length as padding.
    """
    parts: list[list[int]] = []
    # Stable, so that equal lengths keep their order and a run can be repeated.
    for row in np.argsort(n_frames, kind="stable").tolist():
        if parts and len(parts[-1]) < largest and n_frames[row] <= (1 + _MOST_PADDING) * n_frames[parts[-1][0]]:
            parts[-1].append(row)
        else:
            parts.append([row])
    return [np.array(part) for part in parts]


class SequenceNoise:
    """Standard normal noise of B sequences, draw after draw.

    Args:
        noise_seed: One per sequence.
        n_frames: Frames of each sequence; padding is zero.
        device: Device that the noise is put on.
    """

    def __init__(self, noise_seed: Sequence[int], n_frames: Lengths, device: torch.device | str = "cpu") -> None:
        # One stream a sequence, drawn with NumPy: neither batch nor device changes a number.
        self._generators = [sequence_generator(seed) for seed in noise_seed]
        self._n_frames, self._device = n_frames, device

    def draw(self, columns: int = N_FEATURES) -> Float[torch.Tensor, "batch frames columns"]:
        """Return the next noise of every sequence; as long as the longest."""
        noise = np.zeros((len(self._n_frames), int(self._n_frames.max()), columns), dtype=np.float32)
        for row, (generator, n) in enumerate(zip(self._generators, self._n_frames, strict=True)):
            noise[row, :n] = generator.standard_normal((int(n), columns), dtype=np.float32)
        return torch.from_numpy(noise).to(self._device)


def start_noise(
    noise_seed: Sequence[int], n_frames: Lengths, device: torch.device | str = "cpu", *, columns: int = N_FEATURES
) -> Float[torch.Tensor, "batch frames columns"]:
    """Return noise that sampling starts from, and noise optimisation too: the first draw of each sequence."""
    return SequenceNoise(noise_seed, n_frames, device).draw(columns)


@dataclass(frozen=True)
class ModelBodies:
    """A batch as a model sees it.

    Attributes:
        skeleton: The change of skeleton; None if there is none.
    """

    batch: ConditionBatch
    skeleton: UniformSkeleton | None

    @classmethod
    def of(cls, batch: ConditionBatch, configuration: Any) -> ModelBodies:
        """Return the batch on the skeleton of the model, as its configuration says.

        Without an initial pose (condition ``text``) the body is not known; then the motion keeps the model's size.
        """
        if not configuration.uniform_skeleton or batch.initial_joints is None:
            return cls(batch, None)
        skeleton = UniformSkeleton.of(batch.initial_joints)
        poses = ("initial_joints", "previous_joints", "goal_joints")
        converters: dict[str, Callable[[np.ndarray], np.ndarray]] = dict.fromkeys(poses, skeleton.poses)
        converters["goal_location"] = skeleton.locations
        given = {name: getattr(batch, name) for name in converters}
        changed = {name: converters[name](value) for name, value in given.items() if value is not None}
        return cls(replace(batch, **changed), skeleton)

    def own(self, joints: Float[np.ndarray, "batch frames 22 3"]) -> Float[np.ndarray, "batch frames 22 3"]:
        """Bring what the model has generated to the scale of the bodies, metres."""
        if self.skeleton is None:
            return joints
        return self.skeleton.own_scale(joints.reshape(len(joints), -1, 3)).reshape(joints.shape)


def bone_lengths(pose: Float[torch.Tensor, "*batch 22 3"]) -> Float[torch.Tensor, "*batch 21"]:
    """Lengths of the bones of a pose, metres, in the order of :data:`prbench.geometry.skeleton.BONES`."""
    return bones(pose).norm(dim=-1)


def with_bone_lengths(joints: Joints, lengths: Float[torch.Tensor, "batch 21"]) -> Joints:
    """Keep the directions of all bones, with other lengths; differentiable.

    The pelvis keeps its place over the floor, and the lowest joint its height: longer legs would sink into the floor.

    Args:
        joints: Metres, any frame.
        lengths: Lengths of the bones of each sequence, metres.
    """
    # Positions are sums of bones along the way from the pelvis, which one product with the ancestry gives for all.
    offsets = unit(bones(joints)) * lengths[:, None, :, None]
    # 1 where a bone leads from the pelvis to a joint, else 0.
    leads = torch.zeros(N_JOINTS, N_JOINTS - 1)
    for joint in range(1, N_JOINTS):  # parents come before their children
        leads[joint] = leads[PARENTS[joint]]
        leads[joint, joint - 1] = 1.0
    moved = joints[..., :1, :] + leads.to(joints) @ offsets
    sunk = joints[..., 1].amin(dim=-1) - moved[..., 1].amin(dim=-1)
    return moved + sunk[..., None, None] * moved.new_tensor((0.0, 1.0, 0.0))


# Sequences in one pass, on a processor, where more run no faster and need more memory, and elsewhere.
_LARGEST_PARTS = (16, 256)


class Guidance:
    """Classifier-free guidance of one pass of twice the batch, and how many passes a sampler took.

    x0 = x0_unconditional + scale · (x0_conditional - x0_unconditional). Scale 1 is the conditional estimate alone, in
    one pass of the plain batch.

    Args:
        scale: Guidance weight s.
    """

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.doubled = scale != 1.0
        # Network passes so far, summed over sequences; guidance takes two a sequence, backward passes are none.
        self.passes = 0

    def both(self, conditional: Tensor, unconditional: Tensor) -> Tensor:
        """Return the rows of a pass: the conditional ones, and with guidance the unconditional ones behind them."""
        return torch.cat((conditional, unconditional)) if self.doubled else conditional

    def estimate(self, predict: Callable[[Tensor], Tensor], noisy: Tensor) -> Tensor:
        """Return the guided estimate; ``predict`` gets the noisy rows of :meth:`both` halves."""
        rows = self.both(noisy, noisy)
        self.passes += len(rows)
        predicted = predict(rows)
        if not self.doubled:
            return predicted
        conditional, unconditional = predicted.chunk(2)
        # Extrapolation for scales above 1: lerp is u + s (c - u).
        return torch.lerp(unconditional, conditional, self.scale)


class Guided(Guidance):
    """A denoiser under a condition, as the samplers call it, step by step.

    The unconditional half has zeros for the text vectors and the same condition vector.

    Args:
        denoiser: The denoiser, in evaluation mode.
        condition: B rows.
        n_frames: Valid frames of each row.
        scale: Guidance weight s.
        reuse: Keep what is computed from condition and step for the next chain: for noise optimisation, which walks
            the same steps hundreds of times with frozen weights. The results are the same.
    """

    def __init__(
        self, denoiser: Network, condition: EncodedCondition, n_frames: Counts, scale: float, *, reuse: bool = False
    ) -> None:
        super().__init__(scale)
        self.denoiser = denoiser
        self.condition = condition.then(condition.without_text()) if self.doubled else condition
        # On the CPU a batch without padding is recognised without waiting for the device, and then needs no mask.
        host = n_frames.cpu()
        self._n_frames = self.both(host, host)
        self._prepared: dict[int, Any] | None = {} if reuse else None
        self._masks: dict[int, Tensor | None] = {}

    def __call__(self, noisy: Features, step: int) -> Features:
        """Return the guided estimate of the clean features at ``step`` of the training schedule."""

        def predict(rows: Tensor) -> Tensor:
            frames = rows.shape[1]
            if frames not in self._masks:
                self._masks[frames] = frame_mask(self._n_frames, frames, rows.device)
            return self.denoiser.denoise(rows, self.prepared(step), self._masks[frames])

        return self.estimate(predict, noisy)

    def prepared(self, step: int) -> Any:
        """Keys and values of the condition at ``step``: computed anew, or once only with ``reuse``."""
        if self._prepared is not None and step in self._prepared:
            return self._prepared[step]
        where = self.condition.text.device
        made = self.denoiser.prepare(self.condition, torch.full((1,), step, dtype=torch.long, device=where))
        if self._prepared is not None:
            self._prepared[step] = made
        return made


@dataclass(frozen=True)
class SamplingSettings:
    """Settings of plain sampling.

    Attributes:
        guidance: Weight s of the text; 1 takes one network pass a step, anything else two.
        steps: Steps of the training schedule that are taken; None for all of them.
        parts: What decoding of goal-frame features constructs (:data:`.goal_frame.PARTS`).
        noise_scale: Standard deviation of the noise that sampling starts from. Above the 1 of training, several motions
            of one sequence differ more; 0 gives the one motion of no noise.
    """

    guidance: float
    sampler: Literal["ddpm", "ddim"] = "ddpm"
    steps: int | None = None
    parts: frozenset[str] = TRAINED_WITH
    noise_scale: float = 1.0


def generate(model: MotionModel, batch: ConditionBatch, settings: SamplingSettings) -> Motions:
    """Sample one motion for each row, each from its own noise seed.

    Rows of similar length share a pass; which ones changes a motion by rounding only (less than 1e-4 m).

    Raises:
        AdapterError: if a sequence is longer than the model knows.
    """
    require_lengths(batch, model.configuration.max_frames)
    bodies = ModelBodies.of(batch, model.configuration)
    condition = model.encode(bodies.batch)
    joints = np.zeros((len(batch), int(batch.n_frames.max()), N_JOINTS, 3), dtype=np.float32)
    passes = 0
    columns = model.configuration.n_features
    for rows in parts_of_similar_length(batch.n_frames, _LARGEST_PARTS[model.device.type != "cpu"]):
        own = condition.rows(rows.tolist())
        noise = SequenceNoise([batch.noise_seed[row] for row in rows], batch.n_frames[rows], model.device)
        lengths = torch.as_tensor(batch.n_frames[rows])
        with torch.no_grad():
            denoise = Guided(model.denoiser, own, lengths, settings.guidance)
            start = settings.noise_scale * noise.draw(columns)
            # Further noise is drawn from each sequence's own seed, too.
            if settings.sampler == "ddim":
                clean = sample_ddim(denoise, model.schedule, start, steps=settings.steps)
            else:
                clean = sample_ddpm(
                    denoise, model.schedule, start, lambda _, noise=noise: noise.draw(columns), steps=settings.steps
                )
            found = model.joints(clean, own, lengths, parts=settings.parts)
        joints[rows, : found.shape[1]] = found.cpu().numpy()
        passes += denoise.passes
    return Motions(bodies.own(joints), batch.n_frames, Cost(passes))


def require_lengths(batch: ConditionBatch, most: int) -> None:
    """Refuse sequences of more than ``most`` frames, which a model cannot generate in full.

    Raises:
        AdapterError: with both lengths.
    """
    longest = int(batch.n_frames.max())
    if longest > most:
        raise AdapterError(f"the model generates at most {most} frames, and was asked for {longest}.")


SAMPLING_OPTIONS = ("guidance", "sampler", "steps")
ONE_PASS = "one-pass"
SAMPLERS = ("ddpm", "ddim")


def require_known(options: Mapping[str, str], known: Iterable[str]) -> None:
    """Refuse options that a method does not have.

    Raises:
        ValueError: naming the nearest one, and all.
    """
    names = list(dict.fromkeys(known))
    for key in options:
        if key not in names:
            hint = did_you_mean(key, names)
            raise ValueError(f"unknown option '{key}'.{hint} Known options: {', '.join(names)}.")


def number(options: Mapping[str, str], key: str, default: float, *, least: float = 0.0) -> float:
    """Return a finite number of at least ``least``.

    Raises:
        ValueError: naming the option.
    """
    text = options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= least):
        raise ValueError(f"option '{key}': expected a number of {least:g} or more, found '{text}'.")
    return value


def whole_number(options: Mapping[str, str], key: str, *, most: int) -> int | None:
    """Return a whole number from 1 to ``most``; None if the option is not given.

    Raises:
        ValueError: naming the option.
    """
    text = options.get(key)
    if text is None:
        return None
    # int() alone would also take ` 5`, `1_000` and digits of other scripts.
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= most):
        raise ValueError(f"option '{key}': expected a whole number from 1 to {most}, found '{text}'.")
    return int(text)


def choice(options: Mapping[str, str], key: str, values: tuple[str, ...], default: str | None = None) -> str:
    """Return one of ``values``; if the option is not given the default, which is the first unless another is named.

    Raises:
        ValueError: naming the option.
    """
    value = options.get(key, values[0] if default is None else default)
    if value not in values:
        raise ValueError(f"option '{key}': expected {' or '.join(values)}, found '{value}'.")
    return value


def sampling_settings(
    options: Mapping[str, str], *, guidance: float, diffusion_steps: int, samplers: tuple[str, ...] = SAMPLERS
) -> SamplingSettings:
    """Return the options ``guidance``, ``sampler`` and ``steps``; ``one-pass`` walks as ``ddpm`` does.

    Args:
        options: The options that were given.
        guidance: Weight that holds unless the option gives another.
        diffusion_steps: Steps that the model was trained with.
        samplers: Values of ``sampler`` that the method has, its default first.

    Raises:
        ValueError: naming the option with a value that is not possible.
    """
    weight = number(options, "guidance", guidance)
    sampler = "ddim" if choice(options, "sampler", samplers) == "ddim" else "ddpm"
    return SamplingSettings(weight, sampler, whole_number(options, "steps", most=diffusion_steps))
