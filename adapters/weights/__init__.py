"""Weights that come with prbench: ``<name>.safetensors`` and its card ``<name>.json``. Data only."""
