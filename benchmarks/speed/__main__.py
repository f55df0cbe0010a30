"""All timings in one run: ``python -m benchmarks.speed`` from the repository's root."""

from __future__ import annotations

from benchmarks.speed.work import time_curation, time_metrics, time_reading, time_startup


def main() -> None:
    """Time reading, curation, metrics and start-up."""
    time_reading()
    time_curation()
    time_metrics()
    time_startup()


if __name__ == "__main__":
    main()
