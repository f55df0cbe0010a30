"""Training of both networks of GMD in one run (docs/specification/gmd.md#training)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import torch
from jaxtyping import Bool, Float
from torch import nn

from prbench_adapters.diffusion.goal_frame import smoothed
from prbench_adapters.diffusion.model import TextVectors
from prbench_adapters.diffusion.sampling import CosineSchedule
from prbench_adapters.diffusion.training import Draw, losses, scored_losses
from prbench_adapters.diffusion.training import Objective as DenoiserObjective
from prbench_adapters.gmd import model as gmd
from prbench_adapters.training import MotionBatch
from prbench_adapters.training.task import TrainingData, TrainingModule, split_model_table
from prbench_adapters.training.weights import origin_of, read_weights, representation_entry, weights_header

Signal = Float[torch.Tensor, "batch frames columns"]

# Keys that fine-tuning may set otherwise than the weights that it starts from.
FREE_TO_CHANGE = frozenset({"max_frames", "smoothed", "uniform_skeleton"})
_FEATURES_ALONE = DenoiserObjective(joint_loss_weight=0.0)
_BODY_LOSSES = tuple(f"{part}_loss_weight" for part in ("joint", "velocity", "bone", "ray", "foot", "wrist"))


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Settings of the training beside the configuration of the networks.

    Attributes:
        text_drop: Share of sequences whose text is hidden, so that guidance has an unconditional model.
        joint_loss_weight: Weight of the squared error of the decoded joints of the motion network, m²; this and the
            next five are losses of the compared models (:class:`prbench_adapters.diffusion.training.Objective`), which
            GMD does not have.
        path_step_weight: Weight of the squared differences between neighbouring frames' errors of the trajectory
            network; not in GMD.
    """

    text_drop: float = 0.1
    joint_loss_weight: float = 0.0
    velocity_loss_weight: float = 0.0
    bone_loss_weight: float = 0.0
    ray_loss_weight: float = 0.0
    foot_loss_weight: float = 0.0
    wrist_loss_weight: float = 0.0
    path_step_weight: float = 0.0


class GMDTraining(TrainingModule):
    """Motion and trajectory network with their losses; the networks share nothing but batches and optimiser.

    Args:
        networks: Both networks before the first step.
        space: Statistics and projection.
        texts: Vectors of the captions.
        objective: How often the text is hidden.
        origin: Lines for the card about what the weights build upon.
    """

    def __init__(
        self,
        networks: gmd.GMDNetworks,
        *,
        space: gmd.FeatureSpace,
        texts: TextVectors,
        objective: Objective,
        origin: tuple[str, ...] = (),
    ) -> None:
        super().__init__()
        self.networks, self.texts, self.objective, self.origin = networks, texts, objective, origin
        self.configuration = networks.configuration
        self._space = space
        alphas_cumprod = torch.as_tensor(CosineSchedule(self.configuration.diffusion_steps).alphas_cumprod)
        self.signal: torch.Tensor
        self.noise: torch.Tensor
        for name, values in (("signal", alphas_cumprod.sqrt()), ("noise", (1 - alphas_cumprod).sqrt())):
            self.register_buffer(name, values.float(), persistent=False)  # no part of checkpoints

    def forward(self, batch: MotionBatch, step: int) -> dict[str, torch.Tensor]:
        """Mean squared errors over the valid frames: of projected clean features, and of the trajectory's noise.

        Returns:
            ``loss``, the weighted sum of ``motion`` (of features), ``trajectory`` and what else has a weight:
            ``joints``, ``velocities`` and ``bones`` of the motion, and ``path_steps`` of the trajectory.
        """
        with torch.autocast(batch.features.device.type, enabled=False):
            space = self.space(batch.features.device)
            raw = gmd.with_absolute_root(batch.features)
            # Before the projection, which mixes columns and would spread what stands in padding.
            standardised = space.standardised(raw).masked_fill(batch.padding[..., None], 0.0)
            projected = space.projected(standardised)
        text = gmd.caption_vectors(self.texts, batch.text).to(batch.features.device, non_blocking=True)
        generator = self.generator(step)
        # Two draws: the networks learn from different steps and noise, as if they were trained apart.
        motion = self.draw(projected, generator)
        trajectory = self.draw(standardised[..., : gmd.N_ROOT], generator)
        clean = self._predicted(self.networks.motion, projected, motion, text, batch)
        noise = self._predicted(self.networks.trajectory, standardised[..., : gmd.N_ROOT], trajectory, text, batch)
        with torch.autocast(batch.features.device.type, enabled=False):  # turned back into metres: float32 only
            found = self._motion_losses(clean, projected, batch, space)
            error = noise - trajectory.noise
            path = _mean_squared(error, batch.padding)
            steps = _mean_squared(error.diff(dim=1), batch.padding[:, 1:])
        return {
            "loss": found.pop("loss") + path + self.objective.path_step_weight * steps,
            "motion": found.pop("features"),
            "trajectory": path.detach(),
            "path_steps": steps.detach(),
            **found,
        }

    def _motion_losses(
        self, clean: torch.Tensor, projected: torch.Tensor, batch: MotionBatch, space: gmd.FeatureSpace
    ) -> dict[str, torch.Tensor]:
        """Return the motion network's weighted losses: of projected features, and of the joints that they decode to."""
        objective = DenoiserObjective(**{name: getattr(self.objective, name) for name in _BODY_LOSSES})
        if objective == _FEATURES_ALONE:
            loss = _mean_squared(clean - projected, batch.padding)
            return {"loss": loss, "features": loss.detach()}
        raw = space.restored(space.unprojected(clean))
        joints = gmd.decode_absolute(smoothed(raw, batch.n_frames) if self.configuration.smoothed else raw)
        found = losses(objective, clean, projected, joints, batch.joints, batch.padding)
        scored = scored_losses(objective, joints, batch)
        return {**found, **scored, "loss": found["loss"] + scored["loss"]}

    def draw(self, clean: Signal, generator: torch.Generator) -> Draw:
        """Draw for one network; numbers come from the CPU, so they are the same on every device."""
        n = len(clean)
        step = torch.randint(len(self.signal), (n,), generator=generator)
        without_text = torch.rand(n, generator=generator) < self.objective.text_drop
        noise = torch.randn(clean.shape, generator=generator)
        return Draw(*(values.to(clean.device, non_blocking=True) for values in (step, without_text, noise)))

    def _predicted(
        self, network: gmd.TemporalUNet, clean: torch.Tensor, draw: Draw, text: torch.Tensor, batch: MotionBatch
    ) -> torch.Tensor:
        noisy = self.signal[draw.step][:, None, None] * clean + self.noise[draw.step][:, None, None] * draw.noise
        text = text.masked_fill(draw.without_text[:, None], 0.0)
        return network(noisy, draw.step, text, batch.n_frames, window=self.configuration.window(clean.shape[1])).float()

    def space(self, device: torch.device) -> gmd.FeatureSpace:
        """Statistics and projection on a device; a resumed run makes them anew, so no checkpoint holds them."""
        if self._space.mean.device != device:
            self._space = self._space.to(device)
        return self._space

    def gradient_groups(self) -> Sequence[Sequence[nn.Parameter]]:
        """Each network's gradient is clipped by its own norm, as if they were trained apart."""
        return tuple(self.networks.motion.parameters()), tuple(self.networks.trajectory.parameters())

    def weights(self) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
        """Both networks with statistics and projection, and the header of their file."""
        tensors = {f"networks.{name}": tensor for name, tensor in self.networks.state_dict().items()}
        space = self._space
        tensors |= {"statistics.mean": space.mean, "statistics.std": space.std, "projection": space.projection}
        metadata = weights_header(gmd.KIND, self.configuration, representation_entry(self.configuration.representation))
        return tensors, metadata


def _mean_squared(error: Signal, padding: Bool[torch.Tensor, "batch frames"]) -> Float[torch.Tensor, ""]:
    """Over columns and valid frames."""
    summed = torch.where(padding[..., None], 0.0, error.square()).sum()
    return summed / ((~padding).sum() * error.shape[-1]).clamp_min(1)


class GMDTask:
    """A training task (:class:`~prbench_adapters.training.task.TrainingTask`). Both stages learn from text alone."""

    name = "gmd"
    configurations = "prbench_adapters.gmd"

    def build(self, model: Mapping[str, Any], *, data: TrainingData, initial: Path | None, stage: str) -> GMDTraining:
        """Make both networks in their state before the first step.

        Statistics and projection come from the initial weights where there are some.

        Args:
            model: Keys of :class:`GMDConfiguration` and of :class:`Objective`.
            data: The training split.
            initial: Weights to start from.
            stage: ``pretrain`` or ``finetune``; the same networks learn in both.

        Raises:
            UsageError: if the table does not describe such networks, or the data do not fit them.
            InputFileError: if the initial weights do not fit them.
        """
        del stage  # both are trained alike
        configuration, objective = split_model_table(model, gmd.GMDConfiguration, Objective)
        data.require_fit("the model", configuration)
        texts = TextVectors.of_model(configuration.text_encoder, configuration.text_dimension)
        start = read_weights(initial, kind=gmd.KIND) if initial is not None else None
        networks = gmd.GMDNetworks(configuration)
        if start is not None:
            start.require_same(configuration, apart_from=FREE_TO_CHANGE)
            start.load_into(networks, "networks")
            space = gmd.stored_space(start)
        else:
            # Statistics of the training split with absolute roots; x and z of the root share one deviation.
            found = data.train.statistics(lambda features: gmd.with_absolute_root(torch.tensor(features)).numpy())
            projection = gmd.emphasis_projection(configuration.emphasis)
            space = gmd.FeatureSpace.of(torch.as_tensor(found.mean), torch.as_tensor(found.std), projection)
        origin = (texts.origin, *origin_of(start))
        return GMDTraining(networks, space=space, texts=texts, objective=objective, origin=origin)
