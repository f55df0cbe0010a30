"""Protocols and published numbers of the benchmarks. Data only."""
