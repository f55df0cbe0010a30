"""Weights that come with GMD, each with its card."""
