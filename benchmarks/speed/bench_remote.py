"""Time the same trivial method in process and as a program of its own, one after the other in every repetition.

Run from the repository's root: ``python -m benchmarks.speed.bench_remote [--rows 64] [--frames 150] [--repeats 30]``.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.speed.timing import Row, print_rows
from prbench.contract import Adapter, Condition, ConditionBatch, Motions
from prbench.geometry.skeleton import N_JOINTS
from prbench.harness.methods.messages import batch_of, motions_payload, read_message, write_message
from prbench.harness.methods.motions import generate_checked
from prbench.harness.methods.process import Program
from prbench.harness.methods.remote import RemoteAdapter


class Standing:
    """Holds the initial pose: as good as no work of its own."""

    name = "standing"
    conditions = frozenset({Condition.GOAL_LOCATION})

    def generate(self, batch: ConditionBatch, *, seed: int) -> Motions:  # noqa: ARG002 - nothing is drawn
        """The initial pose, ``batch.n_frames`` times."""
        assert batch.initial_joints is not None
        frames = int(batch.n_frames.max())
        return Motions(np.repeat(batch.initial_joints[:, None], frames, axis=1), batch.n_frames)


def main() -> None:
    """Print one table and what a batch costs more."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=64)
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--repeats", type=int, default=30)
    options = parser.parse_args()
    batch = random_batch(options.rows, options.frames)
    near: Adapter = Standing()
    words = (sys.executable, "-c", "from benchmarks.speed.bench_remote import serve; serve()")
    program = Program("standing", words, Path.cwd(), tuple(os.environ.items()))
    start = time.perf_counter()
    far = RemoteAdapter.start(program, weights=None, options={}, device="cpu", threads=1)
    starting = time.perf_counter() - start
    require_equal(near, far, batch)
    inside, outside = zip(*((once(near, batch), once(far, batch)) for _ in range(options.repeats)), strict=True)
    far.close()

    ours, other = min(outside), min(inside)
    rows = [Row("as a program of its own", ours), Row("in process", other)]
    print_rows(f"one batch of {options.rows} sequences of {options.frames} frames, generated and checked", rows)
    more, size = ours - other, batch.n_frames.sum() * N_JOINTS * 3 * 4
    print(f"a program of its own: {1e3 * more:.1f} ms more a batch ({size / 1e6:.1f} MB), {ours / other:.1f} times;")
    print(f"that is {more:.1%} of a batch that takes its method 1 s. Started in {starting:.2f} s, once a worker.")


def once(adapter: Adapter, batch: ConditionBatch) -> float:
    """Seconds of one batch, generated and checked as in a run."""
    start = time.perf_counter()
    generate_checked(adapter, batch, seed=0, method=adapter.name, sequence_ids=batch.opaque_id)
    return time.perf_counter() - start


def require_equal(near: Adapter, far: Adapter, batch: ConditionBatch) -> None:
    """The first batch of both, as warm-up; the same bytes or an exit."""
    first, second = (
        generate_checked(adapter, batch, seed=0, method=adapter.name, sequence_ids=batch.opaque_id)[0]
        for adapter in (near, far)
    )
    if not np.array_equal(first.joints, second.joints):
        raise SystemExit("the same method gives other motions as a program of its own")


def random_batch(rows: int, frames: int) -> ConditionBatch:
    """Noise under ``goal-loc``, all rows of one length."""
    rng = np.random.default_rng(0)
    joints = rng.normal(size=(2, rows, N_JOINTS, 3)).astype(np.float32)
    return ConditionBatch(
        condition=Condition.GOAL_LOCATION,
        n_frames=np.full(rows, frames),
        fps=20.0,
        opaque_id=tuple(f"{row:064x}" for row in range(rows)),
        noise_seed=tuple(range(rows)),
        text=("The person moves across and picks an object.",) * rows,
        initial_joints=joints[0],
        previous_joints=joints[1],
        goal_location=rng.normal(size=(rows, 3)),
    )


def serve() -> None:
    """The program's side: answer until stdin ends."""
    method, stdin, stdout = Standing(), sys.stdin.buffer, sys.stdout.buffer
    while (message := read_message(stdin)) is not None:
        header, payload = message
        if payload is None:
            conditions = sorted(method.conditions)
            write_message(
                stdout, {"message": "hello", "wire": 1, "name": "standing", "version": "1", "conditions": conditions}
            )
            continue
        batch = batch_of(header, payload)
        motions = method.generate(batch, seed=header["seed"])
        write_message(
            stdout, {"message": "motions", "batch": header["batch"]}, motions_payload(batch.opaque_id, motions)
        )


if __name__ == "__main__":
    main()
