"""Procedural people with known truth: motion (``people``), sensor noise, and native files (``layouts``)."""
