"""One command of prbench in a process of its own, which says at its end what it took.

``python -m benchmarks.speed.measured_child REPORT WORDS…`` runs ``prbench WORDS…`` and writes a line of JSON to REPORT.
``WORDS`` may begin with the name of a function of :mod:`benchmarks.speed.growth_work` instead.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

from benchmarks.speed.peak_memory import peak_megabytes


def main() -> int:
    """Run the work and write processor time, duration and peak of memory."""
    report, name, *words = sys.argv[1:]
    start = time.perf_counter()
    code = _run(name, words)
    taken = {
        "megabytes": peak_megabytes(),
        "processor_s": time.process_time(),
        "seconds": time.perf_counter() - start,
        "code": code,
    }
    Path(report).write_text(json.dumps(taken))
    return code


def _run(name: str, words: list[str]) -> int:
    from benchmarks.speed import growth_work

    work = getattr(growth_work, name, None)
    if work is not None:
        work(*words)
        return 0
    from prbench.cli.main import main as prbench

    return int(prbench([name, *words]) or 0)


if __name__ == "__main__":
    sys.exit(main())
