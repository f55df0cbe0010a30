"""Training of DART: primitives cut out of motions, losses, both stages, and the task of ``prbench train``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional

from prbench.errors import UsageError
from prbench.protocol.manifests import load_protocol
from prbench_adapters.dart import model as dart
from prbench_adapters.dart.rollout import next_history
from prbench_adapters.diffusion.denoiser import TransformerLayer
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddpm
from prbench_adapters.diffusion.training import foot_loss, ray_loss
from prbench_adapters.kinematics import DART, forward_kinematics, rest_offsets
from prbench_adapters.training import MotionBatch, SequenceDataset, collate
from prbench_adapters.training.configuration import require_within
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import origin_of, read_weights, weights_header

Poses = Float[Tensor, "batch 22 3"]
Places = Int[Tensor, " windows"]  # a motion, or a frame, for each window

# Floors of positions and rotations, their deltas, joints, theirs: bones that never turn keep their scale (the original
# divided 12 such features of a user's data by zero).
_STD_FLOORS = ((135, 0.01), (9, 0.001), (66, 0.01), (66, 0.001))
_ITEMS_AT_ONCE = 64


@dataclass(frozen=True)
class Window:
    """Consecutive primitives of B motions.

    Attributes:
        frames: All of them, in the motions' own worlds with Z up; primitive k has the frames k·F to k·F + H + F.
        valid: True for primitives that lie inside their motion, the step that leads on from their last frame included.
        start: Number of the first frame in its motion, 0 for the frame before the motion's first.
        goal: Goal location of each motion, canonical frame with Y up, metres; NaN for motions of a corpus.
    """

    frames: dart.Frames
    valid: Bool[Tensor, "batch primitives"]
    start: Places
    goal: Float[Tensor, "batch 3"]

    def primitive(self, number: int, future_frames: int) -> dart.Frames:
        """Cut out one primitive, in its own frame of reference."""
        start = number * future_frames
        return self.frames.part(start, start + dart.HISTORY_FRAMES + future_frames).canonical()[0]

    def placement(self, number: int, future_frames: int) -> dart.Placement:
        """Return the placement of a primitive's frame of reference in the motion's world."""
        return dart.canonical_placement(self.frames.joints[:, number * future_frames])


def window(
    batch: MotionBatch, rows: Places, start: Places, primitives: int, configuration: dart.DartConfiguration
) -> Window:
    """Cut primitives out of motions, of which the frame before the first belongs to them.

    Args:
        batch: The motions.
        rows: Which motion each window is cut out of.
        start: First frame of each window, 0 for the frame before the motion's first.
        primitives: How many; those that reach over the end repeat the last frame and are marked.
        configuration: Frames of a primitive.
    """
    # The frame before the first is recorded, too, and gives the first primitive its history.
    motions = torch.cat((batch.previous_joints[:, None], batch.joints), dim=1)
    last = batch.n_frames[rows]  # its index in these
    length = dart.HISTORY_FRAMES + primitives * configuration.future_frames + 1
    wanted = start[:, None] + torch.arange(length, device=motions.device)
    joints = motions[rows[:, None], torch.minimum(wanted, last[:, None])]
    # Where the last delta of each primitive leads to: one frame behind the primitive itself.
    numbers = torch.arange(1, primitives + 1, device=motions.device)
    ends = start[:, None] + dart.HISTORY_FRAMES + configuration.future_frames * numbers
    frames = dart.Frames.of_joints(DART.from_y_up(joints))
    return Window(frames, ends <= last[:, None], start, batch.goal_location[rows])


def drawn_starts(
    n_frames: Int[Tensor, " batch"], primitives: int, configuration: dart.DartConfiguration, generator: torch.Generator
) -> Int[Tensor, " batch"]:
    """Return a uniformly drawn first frame for each motion, from which the whole window fits where it can."""
    latest = (n_frames - dart.HISTORY_FRAMES - primitives * configuration.future_frames).clamp_min(0)
    return (torch.rand(len(n_frames), generator=generator, dtype=torch.float64) * (latest + 1)).long().clamp_max(latest)


def feature_scaling(data: SequenceDataset, configuration: dart.DartConfiguration) -> dart.FeatureScaling:
    """Mean and floored standard deviation of the features of all primitives, each in its own frame of reference.

    Raises:
        UsageError: if no motion is long enough for a primitive.
    """
    # Sums of squares of a whole corpus lose their last digits in float32.
    total = torch.zeros(dart.N_FEATURES).double()
    squares = torch.zeros(dart.N_FEATURES).double()
    count = 0
    for primitives in primitives_of(data, range(len(data)), configuration):
        features = primitives.pack().flatten(0, 1)
        total += features.double().sum(dim=0)
        squares += features.double().square().sum(dim=0)
        count += len(features)
    if not count:
        found = "found no motion in the training split that has as many. Raise it, or use other tables."
        raise UsageError(f"data.max_frames: a motion primitive takes {configuration.primitive_frames} frames, {found}")
    mean = total / count
    floor = torch.cat([torch.full((n,), value) for n, value in _STD_FLOORS]).double()
    std = (squares / count - mean.square()).clamp_min(0.0).sqrt().maximum(floor)
    return dart.FeatureScaling(mean.float(), std.float())


def primitives_of(
    data: SequenceDataset,
    places: Sequence[int],
    configuration: dart.DartConfiguration,
    device: torch.device | str = "cpu",
) -> Iterator[dart.Frames]:
    """Yield the primitives of some motions, end to end from the first frame, each in its own frame of reference."""
    for first in range(0, len(places), _ITEMS_AT_ONCE):
        batch = collate([data[place] for place in places[first : first + _ITEMS_AT_ONCE]]).to(device)
        primitives = configuration.primitives_for(int(batch.n_frames.max()) + 1)
        rows = torch.arange(len(batch), device=batch.n_frames.device)
        cut = window(batch, rows, torch.zeros_like(rows), primitives, configuration)
        for number in range(primitives):
            inside = cut.valid[:, number]
            if bool(inside.any()):
                frames = cut.primitive(number, configuration.future_frames)
                yield frames.each(lambda values, inside=inside: values[inside])


_PerMotion = Float[Tensor, " batch"]
Shares = tuple[float, float, float]
# Names of the parts of the loss; those that a phase does not have are 0 in its log.
PARTS = ("reconstruction", "divergence", "body", "consistency", "deltas", "latent")


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Weights of the losses, and how the training is divided; the defaults are the original's.

    Raises:
        ValueError: for shares that divide nothing.

    Attributes:
        vae_share: Share of the VAE's phase in the training, after which it is frozen and the denoiser trained. 0 keeps
            the VAE of the initial weights.
        vae_stages: Shares of the phase in which primitives start from recorded history, ever more often from the end of
            what was just predicted, and always from that.
        primitives: Consecutive ones of each training motion.
        windows: Number of times that they are drawn from each motion of a batch.
        vae_batch_size: Motions of each batch that the VAE's phase looks at; None for all.
        joint_weight: Weight of joints that follow from predicted rotations, against the recorded.
        consistency_weight: Weight of predicted joints against those that follow from predicted rotations.
        vae_delta_weight: Weight of predicted deltas against differences of predictions: translation, orientation and
            joints each.
        ray_loss_weight: Weight of the miss of the head's axes (:func:`scored_losses`), m², in both phases; not in the
            original.
        foot_loss_weight: Weight of the squared steps of planted toes, m², in both phases, too.
        text_drop: Share of motions whose text is hidden, so that guidance has an unconditional model.
    """

    vae_share: float = 0.4
    vae_stages: Shares = (0.5, 0.25, 0.25)
    denoiser_stages: Shares = (1 / 3, 1 / 3, 1 / 3)
    primitives: int = 4
    windows: int = 1
    vae_batch_size: int | None = None
    kl_weight: float = 1e-6
    joint_weight: float = 10.0
    consistency_weight: float = 10.0
    vae_delta_weight: float = 100.0
    latent_weight: float = 1.0
    denoiser_delta_weight: float = 1e4
    ray_loss_weight: float = 0.0
    foot_loss_weight: float = 0.0
    text_drop: float = 0.1

    def __post_init__(self) -> None:
        require_within(self, "at least 0 and below 1", "vae_share")
        for name in ("vae_stages", "denoiser_stages"):
            shares = getattr(self, name)
            if min(shares) < 0 or abs(sum(shares) - 1) > 1e-6:
                raise ValueError(f"'{name}' must be three shares that sum to 1, found {shares}")
        optional = () if self.vae_batch_size is None else ("vae_batch_size",)
        require_within(self, "at least 1", "primitives", "windows", *optional)
        require_within(self, "at least 0", "ray_loss_weight", "foot_loss_weight")
        require_within(self, "from 0 to 1", "text_drop")


def huber(predicted: Float[Tensor, "batch *values"], wanted: Float[Tensor, "batch *values"]) -> _PerMotion:
    """Huber's loss with δ = 1, mean over each motion's values."""
    return functional.huber_loss(predicted, wanted, reduction="none").flatten(1).mean(dim=1)


def divergence(mean: Float[Tensor, "batch 1 latent"], log_variance: Float[Tensor, "batch 1 latent"]) -> _PerMotion:
    """Divergence from the standard normal distribution, mean over dimensions."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).flatten(1).mean(dim=1)


def body_losses(predicted: dart.Frames, recorded: dart.Frames, offsets: Poses) -> tuple[_PerMotion, _PerMotion]:
    """Compare the joints that follow from predicted rotations with the recorded and with the predicted joints.

    Args:
        predicted: Future frames.
        recorded: The same in the recording.
        offsets: Bones of each motion (:func:`prbench_adapters.kinematics.rest_offsets`).
    """
    moved = forward_kinematics(predicted.rotations(), predicted.translation, offsets[:, None])
    return huber(moved, recorded.joints), huber(predicted.joints, moved)


def delta_loss(predicted: dart.Frames, history: dart.Frames) -> _PerMotion:
    """Compare deltas with the differences that they announce, from the last frame of the history on; sum of three.

    Args:
        predicted: Future frames.
        history: The frames before them, in the same frame of reference.
    """
    # The last frame of the history announces the step to the first predicted frame.
    before = history.part(dart.HISTORY_FRAMES - 1, dart.HISTORY_FRAMES)

    def chain(name: str) -> Tensor:
        return torch.cat((getattr(before, name), getattr(predicted, name)), dim=1)

    orientation = chain("orientation")
    return (
        huber(chain("translation_delta")[:, :-1], chain("translation").diff(dim=1))
        + huber(chain("orientation_delta")[:, :-1], orientation[:, 1:] @ orientation[:, :-1].mT)
        + huber(chain("joints_delta")[:, :-1], chain("joints").diff(dim=1))
    )


def scored_losses(shown: Float[Tensor, "batch primitives frames 22 3"], cut: Window, fps: float) -> dict[str, Tensor]:
    """Losses of what the benchmark looks at, over all primitives of a window inside their motion.

    Most primitives contain no prime time, so each frame is weighed by its own time in the sequence.

    Args:
        shown: The last frame of each primitive's history and the F predicted ones, motion's world with Y up, metres.
        cut: The recorded window.
        fps: Frames per second.

    Returns:
        ``ray`` (:func:`prbench_adapters.diffusion.training.ray_loss`), 0 for motions without a goal, and ``feet``
        (:func:`prbench_adapters.diffusion.training.foot_loss`).
    """
    primitives, frames = shown.shape[1:3]
    first = dart.HISTORY_FRAMES - 1 + (frames - 1) * torch.arange(primitives, device=shown.device)
    places = first[:, None] + torch.arange(frames, device=shown.device)
    # Each primitive is a motion of its own, because it goes on from the history that the network was given, which is
    # the recorded one as often as the end of the primitive before.
    predicted = shown.flatten(0, 1)
    recorded = DART.to_y_up(cut.frames.joints[:, places]).flatten(0, 1)
    valid = cut.valid.flatten()[:, None].expand(-1, frames)
    goal = cut.goal.repeat_interleave(primitives, dim=0)
    # Sequences begin a fixed time before the prime time; their first frame is number 1 of the motion.
    seconds = (cut.start[:, None, None] + places - 1).flatten(0, 1) / fps - load_protocol().curation.lead
    aimed = valid & torch.isfinite(goal).all(dim=-1, keepdim=True)
    rays = ray_loss(predicted[:, 1:], recorded[:, 1:], goal, aimed[:, 1:], seconds[:, 1:])
    return {"ray": rays, "feet": foot_loss(predicted, recorded, valid, fps)}


def feedback(progress: float, stages: Shares) -> float:
    """Probability of starting from one's own prediction: 0 in the first stage, 1 in the last, rising in between."""
    recorded, rising, _ = stages
    if progress < recorded:
        return 0.0
    return min(1.0, (progress - recorded) / rising) if rising else 1.0


_MEASURED_MOTIONS = 512
_Latents = Float[Tensor, "batch 1 latent"]


@dataclass(frozen=True)
class _Given:
    """A primitive of each motion, as the networks get it.

    Attributes:
        recorded: Its frames, in its own frame of reference.
        history: Standardised features of the history, of some motions the end of what was just predicted.
        future: Standardised features of the recorded future.
    """

    recorded: dart.Frames
    history: Float[Tensor, "batch history 276"]
    future: Float[Tensor, "batch future 276"]


@dataclass(frozen=True)
class _Made:
    """What the networks make of a primitive.

    Attributes:
        features: Standardised features of the future.
        latent: The latent that they are decoded from, the denoiser's divided by the latents' deviation.
        clean: The latent that the denoiser is to make.
        mean: Mean of the latents of the recorded future.
        log_variance: Logarithm of their variance.
    """

    features: Float[Tensor, "batch future 276"]
    latent: _Latents
    clean: _Latents
    mean: _Latents
    log_variance: _Latents


class DartTraining(TrainingModule):
    """Both networks with their losses.

    Args:
        vae: The autoencoder before the first step.
        denoiser: The denoiser before the first step.
        scaling: Scaling of the features.
        texts: Vectors of the captions.
        objective: Weights of the losses and shares of the phases.
        data: The training split, on which the latents' standard deviation is measured once the VAE is trained.
        latent_std: Deviation of the latents of the initial weights, if their VAE is kept; else 0.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        vae: dart.PrimitiveVAE,
        denoiser: dart.LatentDenoiser,
        *,
        scaling: dart.FeatureScaling,
        texts: TextVectors,
        objective: Objective,
        data: SequenceDataset,
        latent_std: float = 0.0,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.vae, self.denoiser, self.texts = vae, denoiser, texts
        self.objective, self.data, self.origin = objective, data, origin
        scored = {"ray": objective.ray_loss_weight, "feet": objective.foot_loss_weight}
        self.scored = {name: weight for name, weight in scored.items() if weight}
        self.configuration, self.schedule = vae.configuration, CosineSchedule(vae.configuration.diffusion_steps)
        self.mean: Tensor
        self.std: Tensor
        self.latent_std: Tensor
        self.register_buffer("mean", scaling.mean, persistent=False)
        self.register_buffer("std", scaling.std, persistent=False)
        self.register_buffer("latent_std", torch.tensor([latent_std]))  # 0 until it is measured; kept in checkpoints

    def forward(self, batch: MotionBatch, step: int) -> dict[str, Tensor]:
        """Losses of consecutive primitives of each motion: of the VAE or of the denoiser, whichever's turn it is.

        Returns:
            ``loss`` and its parts, unweighted (:data:`prbench_adapters.dart.training.PARTS`, and those of
            :func:`scored_losses` that have a weight).
        """
        if torch.distributed.is_available() and torch.distributed.is_initialized():
            why = "dart is trained by one process, because only one of its two networks has gradients at a time;"
            remedy = "leave --devices out. At paper size it fits one GPU."
            raise UsageError(f"--devices: {why} {remedy}")
        of_vae, _, share_of_own = self.moment(step)
        generator = self.generator(step)
        most = self.objective.vae_batch_size if of_vae else None
        rows = torch.arange(min(len(batch), most or len(batch))).repeat_interleave(self.objective.windows)
        n = self.objective.primitives
        device = batch.joints.device
        starts = drawn_starts(batch.n_frames.cpu()[rows], n, self.configuration, generator)
        with torch.autocast(device.type, enabled=False):
            cut = window(batch, rows.to(device), starts.to(device), n, self.configuration)
        self.vae.train(self.training and of_vae)
        if of_vae:
            return self._losses(cut, None, share_of_own, generator)
        self._measure_latents()
        texts = tuple(batch.text[row] for row in rows.tolist())
        hidden = torch.rand(len(texts), generator=generator) < self.objective.text_drop
        text = dart.pooled_texts(self.texts, texts).masked_fill(hidden[:, None], 0.0).to(device)
        # The decoder passes gradients on to the denoiser and gets none itself, so its optimiser leaves it alone.
        self.vae.requires_grad_(False)
        try:
            return self._losses(cut, text, share_of_own, generator)
        finally:
            self.vae.requires_grad_(True)

    def moment(self, step: int) -> tuple[bool, float, float]:
        """Return the phase of a call: whether it is the VAE's, the share of it that is over, and that of own histories.

        A validation is in the phase of the training around it, without own histories.
        """
        if step < 0:
            return not bool(self.latent_std > 0), 0.0, 0.0
        # Counted in calls, so that a resumed training is in the same phase.
        of_vae = round(self.objective.vae_share * self.calls)
        if step < of_vae:
            progress = step / of_vae
            return True, progress, feedback(progress, self.objective.vae_stages)
        progress = min(1.0, (step - of_vae) / max(1, self.calls - of_vae))
        return False, progress, feedback(progress, self.objective.denoiser_stages)

    def comparable_from(self) -> int:
        """Return the step after the denoiser's first; validations before it measured the VAE."""
        return round(self.objective.vae_share * self.calls) + 1

    def learning_rate_factor(self, step: int) -> float:
        """Falls linearly to 0 in each phase."""
        return max(0.0, 1.0 - self.moment(step)[1])

    def _losses(
        self, cut: Window, text: Tensor | None, share_of_own: float, generator: torch.Generator
    ) -> dict[str, Tensor]:
        """Return the losses of the VAE, or with texts of the denoiser, averaged over primitives inside their motion."""
        in_float32 = partial(torch.autocast, cut.valid.device.type, enabled=False)
        scaling = dart.FeatureScaling(self.mean, self.std)
        sums: dict[str, Tensor] = {}
        shown: list[Tensor] = []
        own: dart.Frames | None = None
        for number in range(self.objective.primitives):
            with in_float32():
                given = self._given(cut, number, own, share_of_own, generator)
            made = self._made(given, text, generator)
            with in_float32():
                predicted = scaling.frames(made.features.float())
                losses, bodies = self._compared(given, made, predicted, of_vae=text is None)
                for name, loss in losses.items():
                    sums[name] = sums.get(name, 0.0) + torch.where(cut.valid[:, number], loss, 0.0).sum()
                if bodies is not None:
                    placement = cut.placement(number, self.configuration.future_frames)
                    shown.append(DART.to_y_up(placement.points(bodies)))
                if text is None:
                    # Gradients do not run through the history: each primitive learns for itself.
                    own = next_history(predicted)[0].each(torch.Tensor.detach)
            if text is not None and share_of_own > 0 and number + 1 < self.objective.primitives:
                own = self._sampled_history(given.history, text, generator)
        # Over all primitives together, so that each one inside its motion weighs the same.
        count = cut.valid.sum().clamp_min(1)
        found = self._weighed({name: total / count for name, total in sums.items()}, of_vae=text is None)
        if self.scored:
            with in_float32():
                scored = scored_losses(torch.stack(shown, dim=1), cut, self.configuration.fps)
            for name, weight in self.scored.items():
                found["loss"] = found["loss"] + weight * scored[name]
                found[name] = scored[name].detach()
        return found

    def _given(
        self, cut: Window, number: int, own: dart.Frames | None, share_of_own: float, generator: torch.Generator
    ) -> _Given:
        """Return a primitive of the window, which a share of the motions begins with its own end of the one before."""
        scaling = dart.FeatureScaling(self.mean, self.std)
        recorded = cut.primitive(number, self.configuration.future_frames)
        features = scaling.standardised(recorded)
        # The future stays the recorded one, seen from the recorded history: the network learns to come back.
        history, future = features[:, : dart.HISTORY_FRAMES], features[:, dart.HISTORY_FRAMES :]
        chosen = torch.rand(len(features), generator=generator).to(features.device) < share_of_own
        if own is not None:
            history = torch.where(chosen[:, None, None], scaling.standardised(own), history)
        return _Given(recorded, history, future)

    def _made(self, given: _Given, text: Tensor | None, generator: torch.Generator) -> _Made:
        """Return the future as the VAE gives it back, or as the denoiser makes it for a text."""
        mean, log_variance = self.vae.encode(given.history, given.future)
        # The mean alone, divided by one number for all dimensions, as diffusion expects a variance near 1.
        clean = mean.detach() / self.latent_std
        if text is None:
            # Validation judges the mean latent, so that its numbers do not waver.
            noise = _normal(mean.shape, generator, mean.device) if self.training else torch.zeros_like(mean)
            latent = mean + (0.5 * log_variance).exp() * noise
            features = self.vae.decode(latent, given.history)
        else:
            latent = self.denoiser(*self._noisy(clean, generator), text, given.history)
            features = self.vae.decode(latent * self.latent_std, given.history)
        return _Made(features, latent, clean, mean, log_variance)

    def _compared(
        self, given: _Given, made: _Made, predicted: dart.Frames, *, of_vae: bool
    ) -> tuple[dict[str, _PerMotion], Float[Tensor, "batch frames 22 3"] | None]:
        """Compare the future that was made with the recorded one.

        Returns:
            Each part of the loss, and the bodies that :func:`scored_losses` looks at: those of the rotations, as
            generation shows them, from the last frame of the history on; None where they have no weight.
        """
        scaling = dart.FeatureScaling(self.mean, self.std)
        reconstruction = huber(made.features.float(), given.future)
        deltas = delta_loss(predicted, scaling.frames(given.history))
        offsets = rest_offsets(given.recorded.joints[:, 0])
        bodies = None
        if self.scored:
            last = scaling.frames(torch.cat((given.history[:, -1:], made.features.float()), dim=1))
            bodies = forward_kinematics(last.rotations(), last.translation, offsets[:, None])
        if not of_vae:
            latent = huber(made.latent.float(), made.clean.float())
            return {"latent": latent, "reconstruction": reconstruction, "deltas": deltas}, bodies
        following = given.recorded.part(dart.HISTORY_FRAMES, given.recorded.joints.shape[1])
        body, consistency = body_losses(predicted, following, offsets)
        losses = {
            "reconstruction": reconstruction,
            "divergence": divergence(made.mean.float(), made.log_variance.float()),
            "body": body,
            "consistency": consistency,
            "deltas": deltas,
        }
        return losses, bodies

    def _weighed(self, parts: dict[str, Tensor], *, of_vae: bool) -> dict[str, Tensor]:
        """Return the weighted sum of the parts of the loss as ``loss``, and every part of either phase."""
        objective = self.objective
        weights = {
            "reconstruction": 1.0,
            "divergence": objective.kl_weight,
            "body": objective.joint_weight,
            "consistency": objective.consistency_weight,
            "deltas": objective.vae_delta_weight if of_vae else objective.denoiser_delta_weight,
            "latent": objective.latent_weight,
        }
        loss = torch.stack([weights[name] * part for name, part in parts.items()]).sum()
        return {"loss": loss} | {name: parts.get(name, torch.zeros_like(loss)).detach() for name in PARTS}

    @torch.no_grad()
    def _sampled_history(self, history: Tensor, text: Tensor, generator: torch.Generator) -> dart.Frames:
        """Return end of a primitive from the whole sampling loop, as it will be at inference but without guidance."""
        was_training = self.denoiser.training
        self.denoiser.eval()
        shape = (len(history), 1, self.configuration.latent)

        def denoise(noisy: Tensor, step: int) -> Tensor:
            return self.denoiser(noisy, torch.full((len(noisy),), step, device=noisy.device), text, history)

        start = _normal(shape, generator, history.device)
        latent = sample_ddpm(denoise, self.schedule, start, lambda _: _normal(shape, generator, history.device))
        self.denoiser.train(was_training)
        features = self.vae.decode(latent * self.latent_std, history)
        with torch.autocast(history.device.type, enabled=False):
            return next_history(dart.FeatureScaling(self.mean, self.std).frames(features.float()))[0]

    def _noisy(self, clean: Float[Tensor, "batch 1 latent"], generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Noisy latents and their diffusion steps, uniform."""
        steps = torch.randint(len(self.schedule), (len(clean),), generator=generator)
        level = torch.as_tensor(self.schedule.alphas_cumprod)[steps][:, None, None]
        signal, noise = (values.float().to(clean.device) for values in (level.sqrt(), (1.0 - level).sqrt()))
        return signal * clean + noise * _normal(clean.shape, generator, clean.device), steps.to(clean.device)

    @torch.no_grad()
    def _measure_latents(self) -> None:
        """Measure the latents' standard deviation, one number for all dimensions, when the denoiser's phase begins."""
        if self.latent_std > 0:
            return
        n = len(self.data)
        few = min(len(self.data), _MEASURED_MOTIONS)
        # Spread evenly over the split, so that no dataset decides alone.
        places = [place * n // few for place in range(few)]
        self.vae.eval()
        latents = []
        for frames in primitives_of(self.data, places, self.configuration, self.mean.device):
            features = dart.FeatureScaling(self.mean, self.std).standardised(frames)
            latents.append(self.vae.encode(*features.tensor_split((dart.HISTORY_FRAMES,), dim=1))[0].float())
        self.latent_std.copy_(torch.cat(latents).std().clamp_min(1e-6))

    def weights(self) -> tuple[dict[str, Tensor], dict[str, str]]:
        """Both networks with statistics, and the header of their file."""
        tensors = {f"vae.{name}": tensor for name, tensor in self.vae.state_dict().items()}
        tensors |= {f"denoiser.{name}": tensor for name, tensor in self.denoiser.state_dict().items()}
        tensors |= {"statistics.mean": self.mean, "statistics.std": self.std, "latent.std": self.latent_std}
        return tensors, weights_header(dart.KIND, self.configuration, dart.REPRESENTATION)

    def hidden_matrices(self) -> tuple[nn.Parameter, ...]:
        """Return the matrices of all transformer layers; those of the other network have no gradient and stay."""
        layers = (module for module in self.modules() if isinstance(module, TransformerLayer))
        return tuple(matrix for layer in layers for matrix in layer.parameters() if matrix.ndim == 2)

    def gradient_groups(self) -> tuple[tuple[nn.Parameter, ...], ...]:
        """Each network's gradient is clipped by its own norm."""
        return tuple(self.vae.parameters()), tuple(self.denoiser.parameters())


def _normal(shape: tuple[int, ...], generator: torch.Generator, device: torch.device) -> Tensor:
    """Drawn on the CPU, so the numbers are the same on every device."""
    return torch.randn(shape, generator=generator).to(device)


# Keys that fine-tuning may set otherwise than the weights that it starts from.
FREE_TO_CHANGE = frozenset({"dropout", "uniform_skeleton"})


class DartTask:
    """A training task (:class:`prbench_adapters.training.task.TrainingTask`)."""

    name = "dart"
    configurations = "prbench_adapters.dart"

    def build(self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str) -> DartTraining:
        """Make both networks in their state before the first step.

        Statistics come from the initial weights where there are some, else from the training split.

        Args:
            model: Keys of :class:`DartConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from.
            stage: ``pretrain`` or ``finetune``.

        Raises:
            UsageError: if the table does not describe such a model, or the data do not fit it.
            InputFileError: if the initial weights do not fit it.
        """
        del stage  # both are trained alike
        configuration, objective = split_model_table(model, dart.DartConfiguration, Objective)
        if data.fps != configuration.fps:
            problem = f"the model expects {configuration.fps:g}, found {data.fps:g}. Change one of the two."
            raise UsageError(f"frames per second of the tables: {problem}")
        # A wrong size of text vectors shows before any statistics are computed.
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=dart.KIND) if initial is not None else None
        if objective.vae_share == 0 and start is None:
            raise UsageError("model.vae_share: 0 keeps the VAE of initial weights; give some with --init.")
        vae = dart.PrimitiveVAE(configuration)
        denoiser = dart.LatentDenoiser(configuration)
        if start is not None:
            start.require_same(configuration, apart_from=FREE_TO_CHANGE)
            start.load_into(vae, "vae")
            start.load_into(denoiser, "denoiser")
        scaling = feature_scaling(data.train, configuration) if start is None else dart.scaling_of(start)
        latent_std = 0.0 if start is None or objective.vae_share else float(start.require("latent.std", (1,)))
        about: dict[str, Any] = {"latent_std": latent_std, "origin": (texts.origin, *origin_of(start))}
        return DartTraining(vae, denoiser, scaling=scaling, texts=texts, objective=objective, data=data.train, **about)
