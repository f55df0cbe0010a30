"""Noise optimisation through a frozen diffusion model.

Sources: docs/specification/dno.md#the-solver, docs/specification/pr-model.md#latent-noise-optimisation.
"""

from prbench_adapters.diffusion.noise_optimisation.entry import optimise_noise
from prbench_adapters.diffusion.noise_optimisation.generation import generate_optimised, optimise_batch
from prbench_adapters.diffusion.noise_optimisation.objective import (
    Keyframes,
    PrimeAndReach,
    Targets,
    keyframes,
    prime_and_reach,
)
from prbench_adapters.diffusion.noise_optimisation.options import (
    KEYFRAME_OPTIONS,
    PRIME_AND_REACH_OPTIONS,
    optimisation_settings,
)
from prbench_adapters.diffusion.noise_optimisation.result import History, OptimisedMotions
from prbench_adapters.diffusion.noise_optimisation.settings import OptimisationSettings, dno_paper, fast, paper

__all__ = [
    "KEYFRAME_OPTIONS",
    "PRIME_AND_REACH_OPTIONS",
    "History",
    "Keyframes",
    "OptimisationSettings",
    "OptimisedMotions",
    "PrimeAndReach",
    "Targets",
    "dno_paper",
    "fast",
    "generate_optimised",
    "keyframes",
    "optimisation_settings",
    "optimise_batch",
    "optimise_noise",
    "paper",
    "prime_and_reach",
]
