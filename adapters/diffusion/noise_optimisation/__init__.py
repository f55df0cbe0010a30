"""Noise optimisation through a frozen diffusion model.

Sources: docs/specification/dno.md#the-solver, docs/specification/pr-model.md#latent-noise-optimisation.
"""

from prbench_adapters.diffusion.noise_optimisation.generation import generate_optimised, optimise_batch, optimise_noise
from prbench_adapters.diffusion.noise_optimisation.objective import (
    Keyframes,
    PrimeAndReach,
    Targets,
    keyframes,
    prime_and_reach,
)
from prbench_adapters.diffusion.noise_optimisation.optimise import History, OptimisedMotions
from prbench_adapters.diffusion.noise_optimisation.settings import (
    KEYFRAME_OPTIONS,
    PRIME_AND_REACH_OPTIONS,
    OptimisationSettings,
    dno_paper,
    fast,
    optimisation_settings,
    paper,
)

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
