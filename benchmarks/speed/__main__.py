"""All timings in one run: ``python -m benchmarks.speed`` from the repository's root."""

from benchmarks.speed.work import main

main()
