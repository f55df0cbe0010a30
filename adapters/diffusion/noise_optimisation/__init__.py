"""Noise optimisation through a frozen diffusion model, whose motions come to meet goals.

Sources: docs/specification/dno.md#the-solver, docs/specification/pr-model.md#latent-noise-optimisation.
"""
