"""The shared core of the diffusion methods: denoiser, schedule, sampling, guidance, noise optimisation, training."""
