"""Two nodes of Ray on this machine, which all tests of a process share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.engine.local_cluster import LocalCluster, local_cluster


@pytest.fixture(scope="session")
def cluster() -> Iterator[LocalCluster]:
    with local_cluster(2) as started:
        yield started


@pytest.fixture(scope="session")
def connected(cluster: LocalCluster) -> Iterator[LocalCluster]:
    import ray

    ray.init(address=cluster.address, log_to_driver=False, logging_level="ERROR")
    yield cluster
    ray.shutdown()
