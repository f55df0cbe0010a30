"""The fixtures of tests that run methods."""

from tests.checking.doctor.conftest import crowds
from tests.method_fixtures import install, own_cache, table

__all__ = ["crowds", "install", "own_cache", "table"]
