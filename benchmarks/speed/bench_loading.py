"""Batches a second that training is fed: ``python -m benchmarks.speed.bench_loading`` from the repository's root.

Whole rows are read from the feature store, random crops (for pre-training) are encoded when they are drawn. Without
``--data`` both are of synthetic people. The store is made before the clock starts. Wall time, because that is what a
GPU waits for: nothing else may run beside it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from itertools import islice
from pathlib import Path
from typing import Any

from prbench.cli.main import main as prbench
from prbench_adapters.training.batches import LengthBatches, load_batches
from prbench_adapters.training.dataset import SequenceDataset

# Batches; those that loaders prepare ahead would else count as made in no time.
_WARM_UP = 10
_TIMED = 60
JOBS: dict[str, dict[str, Any]] = {"whole rows": {}, "random crops of 60 frames": {"crop": "random", "max_frames": 60}}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, nargs="+", help="built tables; synthetic people by default")
    parser.add_argument("--batch", type=int, default=64, help="sequences of a batch")
    parser.add_argument("--loaders", type=int, nargs="+", default=(0, 2), help="as in prbench train")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        tables = options.data or [Path(scratch) / "people"]
        if options.data is None:
            prbench(["synthesize", "adt", "--table", "--count", "12", "--out", str(tables[0]), "--quiet"])
        for job, settings in JOBS.items():
            data = SequenceDataset(tables, cache=Path(scratch) / "cache", **settings)
            for loaders in options.loaders:
                batches = load_batches(data, LengthBatches(data, options.batch), workers=loaders)
                ready = [time.perf_counter() for _ in islice(batches, _WARM_UP + _TIMED)]
                rate = _TIMED / (ready[-1] - ready[_WARM_UP - 1])
                print(f"{job}, {loaders} loaders: {rate:.0f} batches of {options.batch} a second")


if __name__ == "__main__":
    main()
