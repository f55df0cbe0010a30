"""A Ray cluster of several nodes on this machine, bound to the loopback address and without a dashboard."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil

# Set before Ray is imported: it would replace the loopback address by the machine's own, and tell its makers of us.
os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

ROOT = Path(__file__).parents[2]
_LOOPBACK = "127.0.0.1"
_STORE = 100_000_000
"""Bytes of memory for objects, a node: little, so that tests can spill."""
_SETTINGS = {
    # A killed node is seen dead soon.
    "health_check_initial_delay_ms": 1000,
    "health_check_period_ms": 1000,
    "health_check_failure_threshold": 3,
    # Ray refuses to spill onto a disk that is fuller than 95 %, which says nothing of the megabytes that tests need.
    "local_fs_capacity_threshold": 1.0,
}


class LocalCluster:
    """A head that is given no work but what it has a processor for, and further nodes of one processor each."""

    def __init__(self) -> None:
        from ray.cluster_utils import Cluster

        # Workers find the tests' own functions by this path.
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH", "")]))
        settings: dict[str, Any] = {
            "num_cpus": 1,
            "num_gpus": 1,  # declared, not there: work is dealt out as if they were
            "object_store_memory": _STORE,
            "node_ip_address": _LOOPBACK,
        }
        self._settings = settings
        head = {**settings, "include_dashboard": False, "_system_config": _SETTINGS}
        self._cluster = _patiently(lambda: Cluster(initialize_head=True, head_node_args=head))
        self._nodes: list[Any] = []

    @property
    def address(self) -> str:
        """Of the head."""
        return self._cluster.address

    def add_node(self) -> None:
        """Start one more node."""
        self._nodes.append(_patiently(lambda: self._cluster.add_node(**self._settings)))

    def kill_node(self) -> None:
        """Kill the processes of the node that was added last, with SIGKILL; started first where there is none."""
        if not self._nodes:
            self.add_node()
        self._cluster.remove_node(self._nodes.pop(), allow_graceful=False)

    def shutdown(self) -> None:
        """End all nodes."""
        self._cluster.shutdown()


def workers() -> list[psutil.Process]:
    """Return the workers of our own cluster, whose nodes are children of this process."""
    found = []
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "RayWorker" in " ".join(process.cmdline()):
                found.append(process)
    return found


def _patiently(start: Callable[[], Any]) -> Any:
    """Start a node, again where a busy machine did not do it within the 30 s that Ray gives it."""
    for _ in range(2):
        with contextlib.suppress(Exception):  # Ray raises just that
            return start()
    return start()


@contextlib.contextmanager
def local_cluster(nodes: int) -> Iterator[LocalCluster]:
    """Start a cluster of so many nodes, the head among them."""
    cluster = LocalCluster()
    try:
        for _ in range(nodes - 1):
            cluster.add_node()
        yield cluster
    finally:
        cluster.shutdown()


if __name__ == "__main__":  # for another process: says its address, and lives until its input ends
    with local_cluster(int(sys.argv[1])) as started:
        sys.stdout.write(f"{started.address}\n")
        sys.stdout.flush()
        sys.stdin.read()
