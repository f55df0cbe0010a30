"""Noise optimisation through a frozen diffusion model (``methods/dno.md``, ``methods/pr-model.md`` section 6)."""

from prbench_adapters.diffusion.noise_optimisation.entry import optimise_noise
from prbench_adapters.diffusion.noise_optimisation.objective import Keyframes, PrimeAndReach, Targets, keyframes
from prbench_adapters.diffusion.noise_optimisation.result import History, OptimisedMotions
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings

__all__ = [
    "History",
    "Keyframes",
    "OptimisationSettings",
    "OptimisedMotions",
    "PrimeAndReach",
    "Targets",
    "keyframes",
    "optimise_noise",
]
