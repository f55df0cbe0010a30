"""The fixtures of tests that run methods."""

from tests.method_fixtures import install, own_cache, table

__all__ = ["install", "own_cache", "table"]
