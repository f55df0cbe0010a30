"""Manifests of datasets, descriptions of benchmarks, protocols and the numbers that the study printed."""
