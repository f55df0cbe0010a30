"""Windows around the primes and events of a prime-and-reach table, from that table alone.

Source: docs/specification/motion-prediction.md#the-anchored-track.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from prbench.errors import UsageError
from prbench.files.storage import sole_writer
from prbench.geometry.skeleton import head_forward, transform_points
from prbench.sequences import SequenceChunk, SequenceTable
from prbench.sequences.dataset_info import Provenance
from prbench_benchmarks.motion_prediction.protocol import AnchoredRules, WindowRules, load_prediction_protocol
from prbench_benchmarks.motion_prediction.table import SCHEMA_VERSION, Run, Window, WindowsInfo, write_windows

_TEXT = ("sequence_id", "recording_id", "participant_id", "split", "action", "pose_source")
_NUMBERS = ("n_frames", "prime_frame", "start_time", "fps", "head_tilt_deg")
_ARRAYS = ("joints", "gaze_direction", "gaze_valid", "goal_location", "world_from_canonical")


def anchors() -> tuple[str, ...]:
    """Return the names of all anchors: the prime, and the protocol's times before the event."""
    return ("prime", *(f"event-{lead:g}" for lead in load_prediction_protocol().anchored.leads))


def build_anchored_windows(data: Path | str, out: Path | str, *, only: Collection[str] = ()) -> WindowsInfo:
    """Make the anchored track of a prime-and-reach table.

    Args:
        data: Folder of the table.
        out: Folder of the windows; an earlier table of windows there is replaced.
        only: Anchors, such as ``prime`` and ``event-1.5``; all if empty.

    Returns:
        The provenance as written.

    Raises:
        TableError: if the table cannot be read, or no sequence is long enough.
        StorageError: if ``out`` cannot be written or holds something else.
        UsageError: for an anchor that the protocol does not have.
    """
    unknown = sorted(set(only) - set(anchors()))
    if unknown:
        raise UsageError(f"--anchor {unknown[0]}: expected some of {', '.join(anchors())}.")
    table = SequenceTable.open(data).with_sequences()
    out = Path(out).expanduser().absolute()
    protocol = load_prediction_protocol()
    fps = table.scalars()["fps"][0].as_py()
    rules = protocol.windows.at(fps)

    def cut() -> Iterator[Run]:
        for chunk in table.chunks(columns=[*_TEXT, *_NUMBERS, *_ARRAYS]):
            for row in range(len(chunk)):
                found = _cut(chunk.take([row]), rules, protocol.anchored)
                windows = tuple(each for each in found.windows if not only or each.anchor in only)
                if windows:
                    yield replace(found, windows=windows)

    source = {name: getattr(table.info, name) for name in Provenance.__struct_fields__}
    options = {"track": "anchored", "table_identity": table.info.identity_digest}
    if only:
        options["anchors"] = ", ".join(name for name in anchors() if name in only)
    source |= {"schema_version": SCHEMA_VERSION, "protocol_version": protocol.version}
    source |= {"protocol_digest": protocol.digest, "input_digest": table.info.content_digest}
    source |= {"options": options, "quarantine": (), "outcomes": {}}
    sizes = {name: getattr(rules, name) for name in ("observed_frames", "future_frames", "fewest_gaze_frames")}
    info = WindowsInfo(**source, **sizes, fps=fps, joint_set="smpl22")
    with sole_writer(out):
        return write_windows(out, info, cut())


def _cut(chunk: SequenceChunk, rules: WindowRules, anchored: AnchoredRules) -> Run:
    """Return the only sequence of a chunk in the room, with its windows that have both halves.

    The windows end at the prime, and at each lead before the event.
    """
    room_from_canonical = chunk.vectors("world_from_canonical").reshape(4, 4)
    sequence_id, recording_id, participant_id, split, action, pose_source = (chunk.strings(name)[0] for name in _TEXT)
    _, prime_frame, start_time, fps, head_tilt_deg = (float(chunk.numbers(name)[0]) for name in _NUMBERS)
    # The canonical frame knows the lowest joint of the whole sequence, the room knows nothing of it.
    joints = transform_points(room_from_canonical, chunk.joints.astype(np.float64))
    # The gaze of some frames before, held where it is not valid; +Z before the first valid one.
    directions = chunk.frames("gaze_direction").astype(np.float64) @ room_from_canonical[:3, :3].T
    valid = chunk.frames("gaze_valid").astype(bool)
    earlier = np.arange(len(valid)) - round(anchored.gaze_delay * fps)
    shown = (earlier >= 0) & valid[np.maximum(earlier, 0)]
    last = np.maximum.accumulate(np.where(shown, earlier, -1))
    gaze = np.where((last >= 0)[:, None], directions[np.maximum(last, 0)], [0.0, 0.0, 1.0])
    head = head_forward(joints, head_tilt_deg)[0]
    about = (sequence_id, recording_id, participant_id, split, "", action, pose_source)
    run = Run(*about, fps, start_time, joints, np.ones(len(joints), dtype=bool), gaze, shown, head)
    goal = transform_points(room_from_canonical, chunk.vectors("goal_location")[0])
    event = run.n_frames - 1
    last_observed = {"prime": int(prime_frame)}
    last_observed |= {f"event-{lead:g}": event - round(lead * rules.fps) for lead in anchored.leads}
    windows = []
    for anchor, border in last_observed.items():
        start = border + 1 - rules.observed_frames
        n_scored = min(rules.future_frames, event - border)
        if start < 0 or n_scored < round(anchored.shortest_future * rules.fps):
            continue
        looking = int(shown[start : border + 1].sum())
        reached = goal if border + n_scored == event else None
        windows.append(Window(start, looking, n_scored, anchor=anchor, goal=reached))
    return replace(run, windows=tuple(windows))
