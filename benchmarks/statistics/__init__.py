"""Simulations that measure what the printed intervals and p-values are worth."""
