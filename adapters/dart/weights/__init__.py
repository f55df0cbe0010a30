"""Weights of DartControl that come with prbench."""
