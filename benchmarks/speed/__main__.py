"""All timings in one run: ``python -m benchmarks.speed`` from the repository's root."""

from __future__ import annotations

import importlib.util

from benchmarks.speed import (
    bench_curation,
    bench_meshes,
    bench_metrics,
    bench_reading,
    bench_remote,
    bench_startup,
    bench_trajectory,
)


def main() -> None:
    """Time reading, long trajectories, curation, meshes, metrics, methods as programs, and start-up."""
    bench_reading.main()
    bench_trajectory.main()
    bench_curation.main()
    if importlib.util.find_spec("open3d") is None:
        print("rays and closest points on meshes: not timed, pip install 'prbench[open3d]'")
    else:
        bench_meshes.main()
    bench_metrics.main()
    bench_remote.main()
    bench_startup.main()


if __name__ == "__main__":
    main()
