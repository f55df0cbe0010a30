"""Imitates the sensors of each dataset: noise-free truth → native readings."""
