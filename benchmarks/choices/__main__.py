"""Measure what the protocol's choices change on synthetic recordings: the numbers of ``docs/protocol-choices.md``.

Run from the repository's root: ``python -m benchmarks.choices [--recordings 40]``. Each variant
acts out the synthetic recordings and curates them into a table of its own in a temporary folder, and the recorded
motion of its test sequences is scored. Takes some minutes on one core and prints Markdown.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from prbench.curation import BuildOptions, CurationOptions, build_from_sources
from prbench.engine import InProcess
from prbench.harness.first_run import default_tables
from prbench.harness.planning import select
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder import read_scores
from prbench.harness.scoring import COLUMNS, targets_of
from prbench.harness.synthetic_table import Staging, synthetic_source
from prbench.metrics import MotionBatch
from prbench.metrics.prime_success import prime_success
from prbench.protocol.manifests import load_protocol
from prbench.protocol.own_protocol import FILE_NAME
from prbench.sequences import SequenceTable

PRESET = "adt"
RECORDINGS = 40
SEED = 0
# N of the study (Prime and Reach, section 5.1), frames.
STUDY_LENGTH = 150
_SAME = 1e-6  # seconds
_SHOWN = ("prime_success", "reach_success")


def _protocol(*, fps: float | None = None, **curation: float) -> BuildOptions:
    """Return the options of a build with a changed protocol, which has a name of its own."""
    own = load_protocol()
    changed = msgspec.structs.replace(own.curation, **curation)
    return BuildOptions(protocol=msgspec.structs.replace(own, name="variant", fps=fps or own.fps, curation=changed))


def main() -> None:
    """Build, score and print every variant, and what a limit of 150 frames leaves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=RECORDINGS, help=f"how many (default: {RECORDINGS})")
    staging = Staging(PRESET, SEED)
    sources = [synthetic_source(staging, index) for index in range(parser.parse_args().recordings)]
    # The readings of the study by name.
    variants = {
        "version 4": BuildOptions(),
        "rays from the camera": BuildOptions(curation=CurationOptions(ray_origin="camera")),
        "wrist in hand": BuildOptions(curation=CurationOptions(in_hand="wrist")),
        "30 frames a second": _protocol(fps=30.0),
        "no near misses": _protocol(near_miss_distance=0.0),
        "near misses up to 10 cm": _protocol(near_miss_distance=0.10),
        "look of 0.1 s": _protocol(minimum_prime=0.1),
        "look of 0.2 s": _protocol(minimum_prime=0.2),
        "movement of the pelvis": BuildOptions(curation=CurationOptions(minimum_movement="pelvis_displacement")),
        "movement of the object": BuildOptions(curation=CurationOptions(minimum_movement="object_displacement")),
        "no minimum movement": _protocol(minimum_movement=0.0),
        "lead of 3 s": _protocol(lead=3.0),
    }
    _print_row("variant", "in test", "other prime", *_SHOWN)
    _print_row(*["---"] * (3 + len(_SHOWN)))
    first: dict[str, float] = {}  # prime times of the protocol's own test sequences, by id
    short: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, options) in enumerate(variants.items()):
            at = Path(folder) / str(number)
            build_from_sources(sources, at / "table", options=options)
            table = SequenceTable.open(at / "table")
            rows = table.scalars(split="test").to_pydict()
            primes = dict(zip(rows["sequence_id"], rows["prime_time"], strict=True))
            if not first:
                first = primes
                lengths = zip(rows["sequence_id"], rows["n_frames"], strict=True)
                short = {name for name, length in lengths if length <= STUDY_LENGTH}
            moved = sum(abs(prime - first.get(name, prime)) > _SAME for name, prime in primes.items())
            # A table of its own protocol is scored by that one.
            own = table.folder / FILE_NAME
            protocol = own if own.is_file() else None
            run_method(RunRequest(method="ground-truth", data=(table.folder,), protocol=protocol, out=at / "run"))
            _print_row(name, len(primes), moved, *_means(at / "run"))
        limited = _means(Path(folder) / "0" / "run", only=short)
        _print_row(f"version 4, at most {STUDY_LENGTH} frames", len(short), 0, *limited)
    print()
    _print_head_forward()


def _print_head_forward() -> None:
    """Print Prime Success of recorded motion in the embedded tables by the angle of the head-forward vector."""
    tables = [table.with_sequences() for table in default_tables(InProcess(), lambda *_: None)]
    _print_row("angle", *(table.info.dataset for table in tables), "mean")
    _print_row(*["---"] * (2 + len(tables)))
    own_angle = ("own angle", 1, 0)
    for name, factor, degrees in (own_angle, ("0°", 0, 0), ("7.4°", 0, 7.4), ("38.3°", 0, 38.3), ("5° less", 1, -5)):
        rates = []
        for table in tables:
            primed = []
            for _, chunk in select(table, split="test", limit=None).windows(COLUMNS):
                motion = MotionBatch(chunk.joints, chunk.offsets)
                targets = targets_of(chunk, chunk.vectors("goal_location"), None)
                targets = replace(targets, head_tilt_deg=factor * targets.head_tilt_deg + degrees)
                primed += prime_success(motion, targets, load_protocol().metrics).tolist()
            rates.append(100 * float(np.mean(primed)))
        _print_row(name, *(f"{rate:.1f}" for rate in [*rates, np.mean(rates)]))


def _print_row(*cells: object) -> None:
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def _means(run: Path, only: Collection[str] | None = None) -> list[str]:
    """Means in % over the sequences of a run, or over some of them."""
    (path,) = run.glob("*/scores.parquet")
    scores = read_scores(path).to_pandas()
    if only is not None:
        scores = scores[scores["sequence_id"].isin(only)]
    return [f"{100 * scores['value'][scores['metric'] == name].mean():.1f}" for name in _SHOWN]


if __name__ == "__main__":
    main()
