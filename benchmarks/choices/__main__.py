"""Measure what the protocol's choices change on synthetic recordings: the numbers of ``docs/protocol-choices.md``.

Run from the repository's root: ``python -m benchmarks.choices [--recordings 40]``. Each variant
acts out the synthetic recordings and curates them into a table of its own in a temporary folder, and the recorded
motion of its test sequences is scored. Takes some minutes on one core and prints Markdown.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np

from prbench.checking.verify_synthetic import match_events, true_events
from prbench.curation import BuildOptions, CurationOptions, build_from_sources
from prbench.curation.curate import curate_recording
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
from prbench.protocol.manifests import load_manifest, load_protocol
from prbench.protocol.own_protocol import FILE_NAME
from prbench.sequences import SequenceTable

PRESET = "adt"
RECORDINGS = 40
SEED = 0
# N of the study (Prime and Reach, section 5.1), frames.
STUDY_LENGTH = 150
# Seconds by which a prime precedes the intended look, to be counted as another look.
EARLY = 1.8
_SAME = 1e-6  # seconds


def _protocol(*, fps: float | None = None, **curation: float) -> BuildOptions:
    """Return the options of a build with a changed protocol, which has a name of its own."""
    own = load_protocol()
    changed = msgspec.structs.replace(own.curation, **curation)
    return BuildOptions(protocol=msgspec.structs.replace(own, name="variant", fps=fps or own.fps, curation=changed))


def main() -> None:
    """Build, score and print every variant, and what a limit of 150 frames leaves."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=RECORDINGS, help=f"how many (default: {RECORDINGS})")
    count = parser.parse_args().recordings
    staging = Staging(PRESET, SEED)
    sources = [synthetic_source(staging, index) for index in range(count)]
    # Map the id of each sequence of the protocol to the time at which its person means to look at the goal.
    planned = {}
    for index in range(count):
        performance = staging.perform(index)
        curated = curate_recording(staging.sense(performance), load_manifest(staging.preset), load_protocol())
        for match in match_events(true_events(staging.preset, performance), curated.events):
            if match.true is None or match.found is None or match.true.prime_planned is None:
                continue
            if match.found.sequence_id is not None:
                planned[match.found.sequence_id] = match.true.prime_planned
    print(_line("variant", *ABOUT, *SHOWN))
    print(_line(*["---"] * (1 + len(ABOUT) + len(SHOWN))))
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
    first: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, options) in enumerate(variants.items()):
            at = Path(folder) / str(number)
            build_from_sources(sources, at / "table", options=options)
            table = SequenceTable.open(at / "table")
            first = first or _primes(table)
            _run(table, "ground-truth", at / "ground-truth")
            print(_line(name, *_about(table, planned, first), *_means(at / "ground-truth")), flush=True)
        print()
        _print_length(SequenceTable.open(Path(folder) / "0" / "table"), Path(folder) / "0")
    print()
    _print_head_forward()


ABOUT = ("sequences", "in test", "gap", f"above {STUDY_LENGTH} frames", "kept", "other prime", "prime on another look")
SHOWN = ("prime_success", "prime_success_onset", "prime_success_gaze", "reach_success", "reach_success_final")


def _line(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"


def _print_length(table: SequenceTable, folder: Path) -> None:
    """Print what a limit of 150 frames leaves of the test sequences, and the scores of what is left."""
    rows = table.scalars(split="test")
    lengths = dict(zip(rows["sequence_id"].to_pylist(), rows["n_frames"].to_pylist(), strict=True))
    short = {name for name, length in lengths.items() if length <= STUDY_LENGTH}
    print(_line("method", "sequences", *SHOWN))
    print(_line(*["---"] * (2 + len(SHOWN))))
    for method in ("ground-truth", "scripted"):
        _run(table, method, folder / method)
        print(_line(f"{method}, all", str(len(lengths)), *_means(folder / method)))
        print(_line(f"{method}, at most {STUDY_LENGTH} frames", str(len(short)), *_means(folder / method, only=short)))


def _print_head_forward() -> None:
    """Print Prime Success of recorded motion in the embedded tables by the angle of the head-forward vector."""
    tables = [table.with_sequences() for table in default_tables(InProcess(), lambda *_: None)]
    print(_line("angle", *(table.info.dataset for table in tables), "mean"))
    print(_line(*["---"] * (2 + len(tables))))
    own = "own angle"
    for name, factor, degrees in ((own, 1, 0), ("0°", 0, 0), ("7.4°", 0, 7.4), ("38.3°", 0, 38.3), ("5° less", 1, -5)):
        rates = []
        for table in tables:
            primed = []
            for _, chunk in select(table, split="test", limit=None).windows(COLUMNS):
                motion = MotionBatch(chunk.joints, chunk.offsets)
                targets = targets_of(chunk, chunk.vectors("goal_location"), None)
                targets = replace(targets, head_tilt_deg=factor * targets.head_tilt_deg + degrees)
                primed += prime_success(motion, targets, load_protocol().metrics).tolist()
            rates.append(100 * float(np.mean(primed)))
        print(_line(name, *(f"{rate:.1f}" for rate in [*rates, np.mean(rates)])))


def _run(table: SequenceTable, method: str, out: Path) -> None:
    """Score a control on the test sequences; a table of its own protocol is scored by that one."""
    own = table.folder / FILE_NAME
    run_method(RunRequest(method=method, data=(table.folder,), protocol=own if own.is_file() else None, out=out))


def _means(run: Path, only: Collection[str] | None = None) -> list[str]:
    """Means in % over the sequences of a run, or over some of them."""
    values: dict[str, list[float]] = {}
    (scores,) = run.glob("*/scores.parquet")
    for row in read_scores(scores).to_pylist():
        if only is None or row["sequence_id"] in only:
            values.setdefault(row["metric"], []).append(row["value"])
    return [f"{100 * np.mean(values[name]):.1f}" if name in values else "–" for name in SHOWN]


def _about(table: SequenceTable, planned: Mapping[str, float], first: Mapping[str, float]) -> list[str]:
    """Count a table's sequences, what it shares with the first one, and the primes before the intended look."""
    rows = table.scalars(split="test")
    gaps = np.asarray(rows["prime_gap"])
    too_long = int((np.asarray(rows["n_frames"]) > STUDY_LENGTH).sum())
    primes = _primes(table)
    shared = [name for name in primes if name in first]
    moved = sum(abs(primes[name] - first[name]) > _SAME for name in shared)
    known = [name for name in primes if name in planned]
    early = sum(primes[name] < planned[name] - EARLY for name in known)
    counts = [str(table.scalars().num_rows), str(len(primes)), f"{gaps.mean():.2f} ± {gaps.std():.2f} s", str(too_long)]
    return [*counts, f"{len(shared)} of {len(first)}", str(moved), f"{early} of {len(known)}"]


def _primes(table: SequenceTable) -> dict[str, float]:
    """Map the id of each test sequence to its prime time."""
    rows = table.scalars(split="test")
    return dict(zip(rows["sequence_id"].to_pylist(), rows["prime_time"].to_pylist(), strict=True))


if __name__ == "__main__":
    main()
