"""Weights that come with WANDR, each with its card."""
