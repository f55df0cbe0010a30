"""All timings in one run: ``python -m benchmarks.speed`` from the repository's root."""

from __future__ import annotations

from benchmarks.speed import bench_curation, bench_metrics, bench_reading, bench_remote, bench_trajectory


def main() -> None:
    """Reading, long trajectories, curation, metrics, methods as programs."""
    bench_reading.main()
    bench_trajectory.main()
    bench_curation.main()
    bench_metrics.main()
    bench_remote.main()


if __name__ == "__main__":
    main()
