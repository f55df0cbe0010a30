"""The map from noise to motion: an unrolled deterministic chain of a frozen denoiser, differentiable end to end."""

from __future__ import annotations

import copy
import weakref
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar, runtime_checkable

import torch
from jaxtyping import Float, Int
from torch import nn

from prbench_adapters.diffusion.batches import with_bone_lengths
from prbench_adapters.diffusion.condition import EncodedCondition
from prbench_adapters.diffusion.denoiser import Denoiser
from prbench_adapters.diffusion.frame_denoiser import FrameDenoiser
from prbench_adapters.diffusion.generation import Guided
from prbench_adapters.diffusion.noise_optimisation.objective import Joints
from prbench_adapters.diffusion.noise_optimisation.optimise import NoiseDecoder
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings
from prbench_adapters.diffusion.sampling import CosineSchedule, sample_ddim

Noise = Float[torch.Tensor, "batch frames features"]
Network = TypeVar("Network", bound=Denoiser | FrameDenoiser)
_COMPILED: weakref.WeakKeyDictionary[nn.Module, Any] = weakref.WeakKeyDictionary()


@runtime_checkable
class FrozenModel(Protocol):
    """The part of a ``MotionModel`` that the optimisation needs."""

    @property
    def denoiser(self) -> Denoiser | FrameDenoiser:
        """The network, in evaluation mode, its weights without gradients."""
        ...

    def joints(self, normalised: Noise, condition: EncodedCondition, n_frames: Int[torch.Tensor, " batch"]) -> Joints:
        """Joints of standardised features, canonical frame, metres."""
        ...


@dataclass
class _Counter:
    passes: int = 0


class UnrolledChain:
    """Noise to joints by ``settings.ddim_steps`` DDIM steps with all gradients kept.

    What the network takes from condition and step is computed once for each kept step and used in every iteration.
    Activations of ``settings.checkpointing`` steps at a time are computed again in the backward pass.

    Args:
        model: Frozen.
        condition: B rows, on the device of the model.
        n_frames: Frames of each sequence, on the CPU.
        settings: Steps, guidance, precision and checkpointing are taken from here.
    """

    def __init__(
        self,
        model: FrozenModel,
        condition: EncodedCondition,
        n_frames: Int[torch.Tensor, " batch"],
        settings: OptimisationSettings,
        *,
        counter: _Counter | None = None,
    ) -> None:
        self._model, self._condition, self._n_frames = model, condition, n_frames
        self._settings, self._counter = settings, counter or _Counter()
        self._schedule = CosineSchedule(model.denoiser.configuration.diffusion_steps)
        denoiser = compiled(model.denoiser) if settings.compiled else model.denoiser
        self._guided = Guided(
            denoiser, condition, n_frames, settings.guidance, reuse=True, precision=settings.precision
        )

    @property
    def network_passes(self) -> int:
        """Forward passes so far, a sequence: two a step with guidance, and those that are computed again."""
        return self._counter.passes

    def __call__(self, noise: Noise) -> Joints:
        """Joints of every sequence, canonical frame, metres."""
        settings = self._settings
        clean = sample_ddim(
            self._denoise,
            self._schedule,
            noise,
            steps=settings.ddim_steps,
            spacing=settings.spacing,
            checkpointing=settings.checkpointing,
        )
        return self._model.joints(clean, self._condition, self._n_frames)

    def rows(self, index: Int[torch.Tensor, " kept"]) -> UnrolledChain:
        """The chain of some of the sequences; passes are counted together."""
        return UnrolledChain(
            self._model,
            self._condition.rows(index),
            self._n_frames[index.cpu()],
            self._settings,
            counter=self._counter,
        )

    def _denoise(self, noisy: Noise, step: int) -> Noise:
        self._counter.passes += 2 if self._guided.doubled else 1
        return self._guided(noisy, step)


class OnOwnBones:
    """A decoder whose motions keep bone lengths that are given (:mod:`prbench_adapters.diffusion.batches`).

    Args:
        decoder: Whose motions.
        lengths: Of each sequence's bones, metres.
    """

    def __init__(self, decoder: NoiseDecoder, lengths: Float[torch.Tensor, "batch 21"]) -> None:
        self._decoder, self._lengths = decoder, lengths

    @property
    def network_passes(self) -> int:
        """Passes of the decoder."""
        return self._decoder.network_passes

    def __call__(self, noise: Noise) -> Joints:
        """Joints of every sequence, canonical frame, metres."""
        return with_bone_lengths(self._decoder(noise), self._lengths)

    def rows(self, index: Int[torch.Tensor, " kept"]) -> OnOwnBones:
        """The same for some of the sequences."""
        return OnOwnBones(self._decoder.rows(index), self._lengths[index])


def compiled(denoiser: Network) -> Network:
    """Send the passes of a network through ``torch.compile``, for any batch and length; compiled at most once.

    Weights are shared. The first pass takes a minute or more, and on a processor needs a C++ compiler.
    """
    if denoiser not in _COMPILED:
        twin = copy.copy(denoiser)  # shares parameters and buffers
        object.__setattr__(twin, "denoise", torch.compile(denoiser.denoise, dynamic=True))
        _COMPILED[denoiser] = twin
    return _COMPILED[denoiser]
