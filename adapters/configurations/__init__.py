"""Training configurations of the diffusion models: ``<task>-<name>.toml``, and the rows of the study's ablations."""
