"""Weights that come with P&R, each with its card."""
