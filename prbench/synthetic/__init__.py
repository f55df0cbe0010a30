"""Procedural people with known truth: motion (``people``), sensor noise, and native files (``layouts``)."""

# Counts changes after which the same seed gives another world; part of every generator's name.
GENERATOR_VERSION = 3
