"""Measure what estimated bodies cost on synthetic recordings: the table of ``docs/specification/three-points.md``.

Run from the repository's root: ``python -m tests.curation.bodies_cost OUT [--seed 0] [--recordings 8]``. Each layout
is curated three times, with the generator's bodies, with those from head and wrists, and with EgoAllo-like ones; the
recorded motion and some methods are scored on each table. Takes a quarter of an hour on one core and prints Markdown.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from scipy.stats import rankdata

from prbench.cli.main import main as prbench
from prbench.geometry.timelines import interpolate
from prbench.harness.run_folder import read_scores
from prbench.readers import reader_for
from prbench.readers.three_point import THREE_POINT
from prbench.recording import BodyStream
from prbench.sequences import SequenceTable

LAYOUTS = ("hd-epic", "hot3d", "adt")
METHODS = {"ground-truth": (), "pr": ("--condition", "goal-loc"), "wandr": ("--condition", "goal-loc"), "static": ()}
SHOWN = ("prime_success", "reach_success")


def main() -> None:
    """Print a row a layout and source of bodies."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, help="an empty folder for trees, tables and runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--recordings", type=int, default=8)
    parser.add_argument("--layout", action="append", choices=LAYOUTS, help="all by default")
    parser.add_argument("--option", action="append", default=[], help="of prbench poses three-point")
    given = parser.parse_args()
    scores = [f"{method} {metric.split('_')[0]}" for method in METHODS for metric in SHOWN]
    header = ["", "layout", "bodies", "MPJPE cm", "sequences", *scores, "ranks", ""]
    print("|".join(header), "|".join(["", *["---"] * (len(header) - 2), ""]), sep="\n", flush=True)  # noqa: T201
    for layout in given.layout or LAYOUTS:
        root = given.out / layout
        extra = ["--egoallo"] if layout == "adt" else []
        _run("synthesize", layout, "--out", root, "--seed", given.seed, "--count", given.recordings, *extra)
        for bodies in ("truth", THREE_POINT, "egoallo"):
            (root / THREE_POINT).mkdir(exist_ok=True)
            if bodies == THREE_POINT:
                options = [word for each in given.option for word in ("--option", each)]
                _run("poses", THREE_POINT, "--root", root, "--dataset", layout, *options)
            poses = "egoallo" if bodies == "egoallo" else THREE_POINT
            error = _compare(layout, root, poses, put_truth=bodies == "truth")
            table = given.out / f"{layout}-{bodies}"
            _run("build-dataset", layout, "--root", root, "--out", table, "--option", f"poses={poses}")
            cells = [layout, bodies, f"{error:.1f}", str(SequenceTable.open(table).scalars().num_rows)]
            means = {
                method: _means(table, given.out / "runs" / f"{layout}-{bodies}-{method}", method) for method in METHODS
            }
            cells += [f"{100 * means[method][metric]:.0f}" for method in METHODS for metric in SHOWN]
            ranks = rankdata([-means[method]["reach_success"] for method in METHODS][1:], method="min")
            print("|".join(["", *cells, " ".join(f"{rank:.0f}" for rank in ranks), ""]), flush=True)  # noqa: T201


def _run(*words: object) -> None:
    with contextlib.redirect_stdout(io.StringIO()):
        code = prbench([*map(str, words), "--quiet"])
    assert code in (0, 3), f"{words} ended with {code}"


def _compare(layout: str, root: Path, poses: str, *, put_truth: bool) -> float:
    """Return the mean distance of the bodies' joints from the generator's, cm; or put those in their place."""
    tilts = pq.read_table(root / "truth" / "recordings.parquet", columns=["recording_id", "neck_tilt_deg"])
    tilt = dict(zip(*(column.to_pylist() for column in tilts.columns), strict=True))
    reader = reader_for(layout, {"poses": poses})
    errors = []
    for found in reader.find(root):
        read = reader.read(found)
        truth = pq.read_table(root / "truth" / "joints" / f"{found.recording_id}.parquet", columns=["t", "joints"])
        times = truth["t"].to_numpy() + read.head.times[0]
        joints = np.array(truth["joints"].to_pylist(), dtype=np.float32).reshape(len(times), 22, 3)
        body = read.body or BodyStream(times, joints.astype(float), np.ones(len(times), dtype=bool))
        inside = body.valid & (body.times >= times[0]) & (body.times <= times[-1])
        away = body.joints[inside] - interpolate(times, joints.astype(float), body.times[inside])
        errors.append(np.linalg.norm(away, axis=-1).mean() * 100)
        if put_truth:
            about = json.dumps({"head_tilt_deg": str(tilt[found.recording_id])})
            arrays = {"times": times, "joints": joints, "valid": np.ones(len(times), dtype=bool), "about": about}
            np.savez(root / THREE_POINT / f"{found.recording_id}.npz", **arrays)
    return 0.0 if put_truth else float(np.mean(errors))


def _means(table: Path, out: Path, method: str) -> dict[str, float]:
    """Run a method on the training sequences, which it has not learnt from, and return the means of its scores."""
    shutil.rmtree(out, ignore_errors=True)
    _run("run", "--method", method, *METHODS[method], "--data", table, "--split", "train", "--out", out)
    found: dict[str, list[float]] = {}
    for path in out.rglob("scores.parquet"):
        for row in read_scores(path).to_pylist():
            found.setdefault(row["metric"], []).append(row["value"])
    return {name: float(np.mean(found[name])) for name in SHOWN}


if __name__ == "__main__":
    main()
