"""Glide: a complete method for prbench in one file, with nothing but NumPy and PyArrow (Python 3.8 or later).

    prbench run --method "cmd:python glide.py" --condition goal-loc --data DIR

It speaks wire protocol 1 (docs/wire-protocol.md): the harness starts this program, writes conditions to its stdin and
reads motions from its stdout. Copy the file and replace `motion` by your own method; the rest stays as it is.

The method turns the body towards the goal, glides there, leans and reaches (goal-loc), or glides into the goal
pose with every bone turning at its own pace (goal-pose). It uses + - * / and square roots only, which IEEE 754 rounds
alike everywhere, so glide.mjs, the same program in JavaScript, gives the same bytes.
"""

import json
import os
import sys
import traceback

import numpy as np
import pyarrow as pa

PELVIS, NECK, HEAD = 0, 12, 15
ARMS = ((16, 18, 20), (17, 19, 21))  # shoulder, elbow, wrist; left, right
LEFT_HIP, RIGHT_HIP, LEFT_SHOULDER, RIGHT_SHOULDER = 1, 2, 16, 17
UPPER_BODY = [3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21]
LEANS = (
    (1.0, 0.0),
    (12 / 13, 5 / 13),
    (4 / 5, 3 / 5),
    (3 / 5, 4 / 5),
    (5 / 13, 12 / 13),
)  # cosine and sine; 0 to 67 degrees
PARENTS = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19)


# ---------------------------------------------------------------- the method


def motion(row, n_frames, fps, settings):
    """Joint positions (n_frames, 22, 3) of one sequence: metres, Y up, canonical frame of the first pose.

    `row` holds what this sequence is given: noise_seed, initial_joints (22, 3), and goal_location (3) or goal_joints.
    """
    chance = uniforms(row["noise_seed"], 3)
    time = np.arange(n_frames) / fps
    if "goal_joints" in row:
        return into_pose(row["initial_joints"], row["goal_joints"], time, fps, chance)
    return to_location(row["initial_joints"], row["goal_location"], time, fps, chance, settings)


def uniforms(noise_seed, count):
    """Numbers in [0, 1) that depend on noise_seed only (SplitMix64, the same in any language)."""
    mask, numbers = 2**64 - 1, []
    for step in range(1, count + 1):
        z = (noise_seed + step * 0x9E3779B97F4A7C15) & mask
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        numbers.append(((z ^ (z >> 31)) >> 11) / 2.0**53)
    return numbers


def to_location(initial, goal, time, fps, chance, settings):
    """Face the goal at about 2 s, then glide until it is within arm's length and reach with the nearer hand."""
    arrive = 1.8 + 0.2 * chance[0]
    stop = settings["stop_before"] + 0.1 * chance[1]
    end = time[-1]
    begin = min(arrive, max(end - 0.5, 0.0))
    turned = smooth(time / arrive)
    reached = smooth((time - begin) / max(end - begin, 1.0 / fps))

    to_goal = goal - initial[PELVIS]
    distance = np.sqrt(to_goal[0] * to_goal[0] + to_goal[2] * to_goal[2])
    cosine, sine = (to_goal[2] / distance, to_goal[0] / distance) if distance > 1e-6 else (1.0, 0.0)
    way = max(distance - stop, 0.0)
    pelvis = np.empty((len(time), 3))
    pelvis[:, 0] = initial[PELVIS, 0] + sine * way * reached
    pelvis[:, 1] = initial[PELVIS, 1]
    pelvis[:, 2] = initial[PELVIS, 2] + cosine * way * reached

    body = turned_about_y(initial - initial[PELVIS], cosine, sine, turned) + pelvis[:, None]
    left, right = (length(body[-1, arm[2]] - goal) for arm in ARMS)
    arm = ARMS[0] if left <= right else ARMS[1]
    body = leaning_to(body, arm, goal, cosine, sine, reached)
    look_at(body, goal, turned)
    reach(body, arm, goal, reached, 0.1 * chance[2])
    return body


def into_pose(initial, final, time, fps, chance):
    """Carry the pelvis over and turn each bone from its first direction into its last; lengths go along."""
    phase = time / max(time[-1], 1.0 / fps)
    progress = smooth(phase + (0.6 * chance[0] - 0.3) * phase * (1.0 - phase))  # some hurry, some tarry
    cosine, sine = heading(final)
    pelvis = (1.0 - progress)[:, None] * initial[PELVIS] + progress[:, None] * final[PELVIS]
    # the last pose as it would stand if it faced +Z, as the first one does
    ahead = turned_about_y(final - final[PELVIS], cosine, -sine, np.ones(1))[0]
    start = initial - initial[PELVIS]
    blended = np.zeros((len(time), 22, 3))
    for joint in range(1, 22):
        parent = PARENTS[joint]
        first, last = start[joint] - start[parent], ahead[joint] - ahead[parent]
        first_length, last_length = length(first), length(last)
        size = (1.0 - progress) * first_length + progress * last_length
        direction = (1.0 - progress)[:, None] * first / max(first_length, 1e-9)
        direction = direction + progress[:, None] * last / max(last_length, 1e-9)
        bone = direction * (size / np.maximum(length(direction), 1e-9))[:, None]
        blended[:, joint] = blended[:, parent] + bone
    return turned_about_y(blended, cosine, sine, progress) + pelvis[:, None]


def leaning_to(body, arm, goal, cosine, sine, progress):
    """Lean from the hips towards the goal, no further than its arm needs."""
    shoulder, elbow, wrist = arm
    reached = length(body[0, elbow] - body[0, shoulder]) + length(body[0, wrist] - body[0, elbow])
    for lean_cosine, lean_sine in LEANS:
        c, s = part_of_turn(lean_cosine, lean_sine, progress)
        leaning = body.copy()
        offset = body[:, UPPER_BODY] - body[:, PELVIS : PELVIS + 1]
        ahead, up = offset[..., 0] * sine + offset[..., 2] * cosine, offset[..., 1]
        further = ahead * c + up * s - ahead
        leaning[:, UPPER_BODY, 0] = body[:, UPPER_BODY, 0] + further * sine
        leaning[:, UPPER_BODY, 1] = body[:, UPPER_BODY, 1] + (up * c - ahead * s - up)
        leaning[:, UPPER_BODY, 2] = body[:, UPPER_BODY, 2] + further * cosine
        if length(leaning[-1, shoulder] - goal) <= 0.98 * reached:
            break
    return leaning


def look_at(body, goal, progress):
    """Bend the neck until a line of sight at right angles to it meets the goal."""
    bone = body[:, HEAD] - body[:, NECK]
    size = np.maximum(length(bone), 1e-9)
    sight = goal - body[:, HEAD]
    sight = sight / np.maximum(length(sight), 1e-9)[:, None]
    upright = bone - dot(bone, sight)[:, None] * sight
    upright = upright / np.maximum(length(upright), 1e-9)[:, None]
    bent = (1.0 - progress)[:, None] * (bone / size[:, None]) + progress[:, None] * upright
    body[:, HEAD] = body[:, NECK] + bent * (size / np.maximum(length(bent), 1e-9))[:, None]


def reach(body, arm, goal, progress, lift):
    """Move the wrist of one arm to the goal, or as near as the arm gets; both bones keep their lengths."""
    shoulder, elbow, wrist = arm
    upper = length(body[0, elbow] - body[0, shoulder])
    lower = length(body[0, wrist] - body[0, elbow])
    hand = body[:, wrist] + progress[:, None] * (goal - body[-1, wrist])
    hand[:, 1] = hand[:, 1] + lift * 4.0 * progress * (1.0 - progress)  # over an edge rather than through it
    to_hand = hand - body[:, shoulder]
    distance = np.maximum(length(to_hand), 1e-6)
    direction = to_hand / distance[:, None]
    distance = np.minimum(np.maximum(distance, abs(upper - lower) + 1e-4), upper + lower - 1e-4)
    side = body[:, elbow] - body[:, shoulder]
    side[:, 1] = side[:, 1] - 0.05 * progress  # an arm that was straight bends downwards
    side = side - dot(side, direction)[:, None] * direction
    side = side / np.maximum(length(side), 1e-9)[:, None]
    along = (distance * distance + upper * upper - lower * lower) / (2.0 * distance)
    height = np.sqrt(np.maximum(upper * upper - along * along, 0.0))
    body[:, elbow] = body[:, shoulder] + direction * along[:, None] + side * height[:, None]
    body[:, wrist] = body[:, shoulder] + direction * distance[:, None]


def smooth(phase):
    """0 to 1 with speed and acceleration zero at both ends."""
    x = np.minimum(np.maximum(phase, 0.0), 1.0)
    return x * x * x * (10.0 - 15.0 * x + 6.0 * x * x)


def heading(pose):
    """Cosine and sine of the yaw of a pose: (1, 0) faces +Z, (0, 1) faces +X."""
    across = pose[RIGHT_HIP] - pose[LEFT_HIP] + pose[RIGHT_SHOULDER] - pose[LEFT_SHOULDER]
    size = np.sqrt(across[0] * across[0] + across[2] * across[2])
    return (-across[0] / size, across[2] / size) if size > 1e-9 else (1.0, 0.0)


def turned_about_y(points, cosine, sine, progress):
    """Points (22, 3) or (frames, 22, 3) turned about the vertical by a growing part of a yaw: (frames, 22, 3)."""
    c, s = part_of_turn(cosine, sine, progress)
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    turned = np.empty((len(progress), 22, 3))
    turned[..., 0], turned[..., 1], turned[..., 2] = x * c + z * s, y, z * c - x * s
    return turned


def part_of_turn(cosine, sine, progress):
    """Cosine and sine (frames, 1) of the part of an angle that is reached at each progress."""
    half_cosine = np.sqrt(max(1.0 + cosine, 0.0) / 2.0)
    half_sine = np.sqrt(max(1.0 - cosine, 0.0) / 2.0) * (1.0 if sine >= 0.0 else -1.0)
    real, imaginary = (1.0 - progress) + progress * half_cosine, progress * half_sine
    size = np.sqrt(real * real + imaginary * imaginary)
    real, imaginary = real / size, imaginary / size
    return (real * real - imaginary * imaginary)[:, None], (2.0 * real * imaginary)[:, None]


def dot(a, b):
    """Of the last axis, added in one fixed order."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]


def length(vectors):
    return np.sqrt(dot(vectors, vectors))


# ---------------------------------------------------------------- the protocol


def main():
    source, sink = sys.stdin.buffer, own_stdout()
    hello, _ = read_message(source)
    try:
        settings = read_settings(hello)
    except ValueError as error:
        write_message(sink, {"message": "error", "text": str(error)})
        return
    conditions = ["goal-loc", "goal-pose"]
    write_message(sink, {"message": "hello", "wire": 1, "name": "glide", "version": "1.0", "conditions": conditions})
    while True:
        request, payload = read_message(source)
        if request is None:
            return  # stdin was closed: the run is over
        if request["message"] != "generate":
            continue
        try:
            ids, motions = generate(request, payload, settings)
        except Exception as error:
            traceback.print_exc()  # to stderr, the log
            write_message(
                sink,
                {
                    "message": "error",
                    "batch": request["batch"],
                    "text": "{}: {}".format(type(error).__name__, error),
                    "out_of_memory": isinstance(error, MemoryError),
                },
            )
        else:
            write_message(sink, {"message": "motions", "batch": request["batch"]}, motions_payload(ids, motions))


def read_settings(hello):
    if hello is None or hello.get("wire") != 1:
        raise ValueError("glide speaks wire protocol 1 only")
    if hello.get("weights") is not None:
        raise ValueError("glide has no weights")
    settings = {"stop_before": 0.4}  # metres between pelvis and goal, on the ground
    for key, value in hello.get("options", {}).items():
        if key != "stop-before":
            raise ValueError("unknown option '{}'; glide knows stop-before (metres)".format(key))
        settings["stop_before"] = float(value)
    return settings


def generate(request, payload, settings):
    """Opaque ids and a list of (n_frames, 22, 3) arrays."""
    with pa.ipc.open_stream(payload) as reader:
        batch = reader.read_next_batch()
    columns = dict(zip(batch.schema.names, batch.columns))
    given = {
        name: columns[name].flatten().to_numpy().astype(np.float64).reshape(shape)
        for name, shape in (
            ("initial_joints", (-1, 22, 3)),
            ("goal_joints", (-1, 22, 3)),
            ("goal_location", (-1, 3)),
        )
        if name in columns
    }
    seeds = columns["noise_seed"].to_pylist()
    motions = []
    for i, n_frames in enumerate(columns["n_frames"].to_pylist()):
        row = {name: values[i] for name, values in given.items()}
        row["noise_seed"] = seeds[i]
        motions.append(motion(row, n_frames, request["fps"], settings))
    return columns["opaque_id"].to_pylist(), motions


def motions_payload(ids, motions):
    """An Arrow IPC stream with one record batch: opaque_id utf8, joints list<float32>."""
    flat = [joints.astype(np.float32).ravel() for joints in motions]
    ends = np.cumsum([0] + [len(values) for values in flat]).astype(np.int32)
    joints = pa.ListArray.from_arrays(pa.array(ends), pa.array(np.concatenate(flat)))
    batch = pa.RecordBatch.from_arrays([pa.array(ids, pa.string()), joints], ["opaque_id", "joints"])
    buffer = pa.BufferOutputStream()
    with pa.RecordBatchStreamWriter(buffer, batch.schema) as writer:
        writer.write_batch(batch)
    return buffer.getvalue().to_pybytes()


def read_message(stream):
    """The next header and its payload; (None, b"") at the end."""
    line = stream.readline(65536)
    if not line:
        return None, b""
    header = json.loads(line.decode("utf-8"))
    return header, stream.read(header.get("bytes", 0))  # a buffered stream: all of it, or the end


def write_message(stream, header, payload=b""):
    if payload:
        header = dict(header, bytes=len(payload))
    stream.write(json.dumps(header).encode("utf-8") + b"\n" + payload)
    stream.flush()


def own_stdout():
    """The real stdout for the protocol alone; whatever prints from here on, libraries in C too, ends in the log."""
    sys.stdout.flush()
    protocol = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return protocol


if __name__ == "__main__":
    main()
