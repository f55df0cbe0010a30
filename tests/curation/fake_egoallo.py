"""Stands in for EgoAllo's inference script in tests: reads and writes the same files, and can misbehave on purpose.

Run as ``python fake_egoallo.py --traj-root DIR --traj-length N [...]``. It shares no code with prbench. The variable
FAKE_BEHAVIOUR is one behaviour for all recordings, or ``name=behaviour`` pairs separated by commas.
"""

import csv
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

DEVICE_CPF = np.array([
    [-0.031860137, -0.998629532, -0.041520951, 0.004993020],
    [0.793353401, 0.0, -0.608761350, -0.051460090],
    [0.607927062, -0.052336008, 0.792266136, -0.049949881],
    [0, 0, 0, 1],
])  # fmt: skip


def matrix(x, y, z, w):
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def read_poses(path):
    with open(path) as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["gravity_z_world"]) < -9, "EgoAllo needs Z up"
    times = [int(row["tracking_timestamp_us"]) for row in rows]
    rate = len(rows) / ((times[-1] - times[0]) / 1e6)
    chosen = rows[:: int(rate // 30)]  # fails below 30 Hz, as the real script does
    heads = []
    for row in chosen:
        pose = np.eye(4)
        pose[:3, :3] = matrix(*(float(row[f"q{axis}_world_device"]) for axis in "xyzw"))
        pose[:3, 3] = [float(row[f"t{axis}_world_device"]) for axis in "xyz"]
        heads.append((pose @ DEVICE_CPF)[:3, 3])
    seconds = np.array([int(row["tracking_timestamp_us"]) / 1e6 for row in chosen])
    return (seconds[1:] * 1e9).astype(np.int64), np.array(heads)[1:]


def write(folder, name, times, heads):
    n = len(times)
    identity = np.tile([1.0, 0, 0, 0], (n, 1)).astype(np.float32)
    below = np.hstack([identity, heads - [0, 0, 0.7]]).astype(np.float32)
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(
        folder / f"20240101-120000_{name}.npz",
        Ts_world_cpf=np.hstack([identity, heads]).astype(np.float32),
        Ts_world_root=below[None],
        body_quats=np.tile(identity[None, :, None], (1, 1, 21, 1)),
        left_hand_quats=np.tile(identity[None, :, None], (1, 1, 15, 1)),
        right_hand_quats=np.tile(identity[None, :, None], (1, 1, 15, 1)),
        betas=np.zeros((1, n, 16), dtype=np.float32),
        frame_nums=np.arange(n),
        timestamps_ns=times,
    )
    (folder / f"20240101-120000_{name}_args.yaml").write_text("guidance_mode: !!python/name:nobody.reads.this\n")


def behaviour_of(recording):
    wanted = os.environ.get("FAKE_BEHAVIOUR", "good")
    pairs = dict(pair.split("=") for pair in wanted.split(",") if "=" in pair)
    return pairs.get(recording, "good") if pairs else wanted


def main():
    options = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=True))
    root, recording = Path(options["--traj-root"]), options["--recording"]
    with open(os.environ["FAKE_CALLS"], "a") as calls:
        calls.write(f"{recording} {options['--traj-length']} {options['--guidance-mode']}\n")
    assert len(list(root.glob("**/*.vrs"))) == 1, "exactly one VRS file"
    assert len(list(root.glob("**/semidense_points.csv.gz"))) == 1, "exactly one file of points"
    behaviour, outputs = behaviour_of(recording), root / "egoallo_outputs"
    sys.stdout.write(f"loading {recording}\n")
    if behaviour == "crash":
        raise RuntimeError("CUDA out of memory")
    if behaviour == "hang":
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        time.sleep(60)
    if behaviour == "nonsense":
        sys.stdout.buffer.write(bytes(range(256)) * 40 + b"\n\x1b[2J{folder}\n")
        return
    times, heads = read_poses(root / "slam" / "closed_loop_trajectory.csv")
    assert len(times) == int(options["--traj-length"]), "the whole recording was asked for"
    if behaviour == "other":
        heads = heads + np.array([2.0, 0, 0])
    if behaviour == "partial":
        times, heads = times[: len(times) // 2], heads[: len(times) // 2]
    if behaviour == "windows":
        for start in range(0, len(times), 96):
            write(outputs, f"{start}-{start + 128}", times[start : start + 128], heads[start : start + 128])
        return
    write(outputs, f"0-{len(times)}", times, heads)
    if behaviour == "broken":
        path = next(outputs.glob("*.npz"))
        path.write_bytes(path.read_bytes()[:1000])


main()
