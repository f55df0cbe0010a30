"""Readers of the example dataset, each with one fault; a child process imports them from here."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from prbench_tabletop.reader import CsvReader
from prbench_tabletop.tracked import TrackedReader
from scipy.spatial.transform import Rotation

from prbench.curation.mending import mended
from prbench.errors import InputFileError
from prbench.geometry.skeleton import Joint, z_up
from prbench.readers import RecordingFiles
from prbench.recording import Recording

Fault = Callable[[Recording], Recording]


def shift(**seconds: float) -> Fault:
    return lambda recording: mended(recording, tuple(seconds.items()), ())


def scale(**factors: float) -> Fault:
    return lambda recording: mended(recording, (), tuple(factors.items()))


def stream(name: str, **fields: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Change fields of one stream."""

    def planted(recording: Recording) -> Recording:
        old = getattr(recording, name)
        return replace(
            recording, **{name: replace(old, **{key: make(getattr(old, key)) for key, make in fields.items()})}
        )

    return planted


def event(**fields: Callable) -> Fault:
    def planted(recording: Recording) -> Recording:
        (old,) = recording.annotated_events
        new = replace(old, **{key: make(getattr(old, key)) for key, make in fields.items()})
        return replace(recording, annotated_events=(new,))

    return planted


def both(*faults: Fault) -> Fault:
    def planted(recording: Recording) -> Recording:
        for fault in faults:
            recording = fault(recording)
        return recording

    return planted


def thousandfold(values: np.ndarray) -> np.ndarray:
    return values * 1000


def slower(recording: Recording) -> Recording:
    """Milliseconds that are taken for seconds, in every stream."""
    names = ("gaze", "head", "camera", "body")
    changed = both(*(stream(name, times=thousandfold) for name in names), event(event_time=thousandfold))(recording)
    return replace(changed, span=(recording.span[0] * 1000, recording.span[1] * 1000))


def gaze_in_head(recording: Recording, change: Callable, *, back: bool) -> Recording:
    turn = Rotation.from_quat(recording.head.rotation, scalar_first=True)
    local = change(turn.inv().apply(recording.gaze.direction))
    return stream("gaze", direction=lambda _: turn.apply(local) if back else local)(recording)


def local_gaze(recording: Recording) -> Recording:
    return gaze_in_head(recording, lambda rays: rays, back=False)


def stuck_gaze(recording: Recording) -> Recording:
    return gaze_in_head(
        recording, lambda rays: np.where(np.arange(len(rays))[:, None] < 100, rays, rays[100]), back=True
    )


def swapped_body(joints: np.ndarray) -> np.ndarray:
    other = {"LEFT": "RIGHT", "RIGHT": "LEFT"}
    names = [each.name.partition("_") for each in Joint]
    return joints[:, [Joint[f"{other.get(side, side)}{join}{rest}"] for side, join, rest in names]]


def swapped_hands(recording: Recording) -> Recording:
    left, right = recording.body.wrists()
    return replace(recording, hands=(replace(left, side="right"), replace(right, side="left")))


def turned(degrees: tuple[float, float, float], name: str = "direction") -> Callable[[np.ndarray], np.ndarray]:
    turn = Rotation.from_rotvec(degrees, degrees=True)
    if name == "rotation":
        return lambda values: (Rotation.from_quat(values, scalar_first=True) * turn).as_quat(scalar_first=True)
    return turn.apply


def with_nan(points: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(points))[:, None] == 7, np.nan, points)


def back(times: np.ndarray) -> np.ndarray:
    return np.concatenate([times[:5], times[6:4:-1], times[7:]])


def at_random(recording: Recording) -> Recording:
    noise = np.random.default_rng().normal(size=recording.gaze.origin.shape) * 1e-4
    return stream("gaze", origin=lambda points: points + noise)(recording)


def xyzw(rotation: np.ndarray) -> np.ndarray:
    return rotation[:, [1, 2, 3, 0]]


def everything_lies(recording: Recording) -> Recording:
    """Z up where Y up is promised."""
    lie = Rotation.from_euler("x", 90, degrees=True)

    def lying(values: np.ndarray) -> np.ndarray:
        return (lie * Rotation.from_quat(values, scalar_first=True)).as_quat(scalar_first=True)

    glasses = [stream(name, position=z_up, rotation=lying) for name in ("head", "camera")]
    return both(*glasses, stream("body", joints=z_up), stream("gaze", origin=z_up, direction=z_up))(recording)


BY_LIMB = [*range(16), 16, 18, 20, 17, 19, 21]  # one arm after the other
FAULTS: dict[str, tuple[str, Fault]] = {
    "millimetres": ("unit", scale(head=1000, camera=1000, body=1000)),
    "centimetres-body": ("unit", scale(body=100)),
    "z-up": ("axes", everything_lies),
    "z-up-body": ("axes", stream("body", joints=z_up)),
    "swapped-quaternion": ("axes", both(stream("head", rotation=xyzw), stream("camera", rotation=xyzw))),
    "backward-head": ("axes", stream("head", rotation=turned((0, 180, 0), "rotation"))),
    "gaze-in-head-frame": ("axes", local_gaze),
    "gaze-mirrored": ("axes", stream("gaze", direction=lambda rays: rays * [-1, 1, 1])),
    "gaze-mirrored-in-z": ("axes", stream("gaze", direction=lambda rays: rays * [1, 1, -1])),
    "gaze-from-the-origin": ("place", stream("gaze", origin=np.zeros_like)),
    "hands-exchanged": ("axes", swapped_hands),
    "sides-exchanged": ("body", stream("body", joints=swapped_body)),
    "joints-shuffled": (
        "body",
        stream("body", joints=lambda joints: joints[:, BY_LIMB]),
    ),
    "milliseconds": ("clock", slower),
    "gaze-in-milliseconds": ("clock", stream("gaze", times=thousandfold)),
    "gaze-late": ("clock", shift(gaze=1.0)),
    "gaze-stuck": ("still", stuck_gaze),
    "raised-body": ("place", stream("body", joints=lambda joints: joints + np.array([0, 1, 0]))),
    "nan": ("read", stream("gaze", origin=with_nan)),
    "clock-back": ("read", stream("gaze", times=back)),
    "long-quaternion": ("read", stream("head", rotation=lambda rotation: rotation * 1.1)),
    "other-id": ("read", lambda recording: replace(recording, recording_id="other")),
    "random": ("repeatable", at_random),
    "order-of-a-set": ("repeatable", lambda recording: replace(recording, messages=tuple(set("abcdefghijkl")))),
    "event-lies": ("events", event(location=z_up, box_min=lambda corner: z_up(corner) - 0.1, box_max=z_up)),
    "event-in-microseconds": ("events", event(event_time=lambda time: time * 1e6)),
    "event-box-in-millimetres": ("events", event(box_max=thousandfold)),
    "gaze-beside": ("build", stream("gaze", direction=turned((15, 0, 0)))),
}
OF_TRACKS: dict[str, tuple[str, Fault]] = {
    "box-in-the-world": ("objects", lambda recording: _boxed(recording, lambda track: track.position[0])),
    "box-in-millimetres": ("objects", lambda recording: _boxed(recording, lambda track: 0, 1000)),
}


def _boxed(recording: Recording, place: Callable, factor: float = 1) -> Recording:
    (track,) = recording.objects
    corners = {name: getattr(track, name) * factor + place(track) for name in ("box_min", "box_max")}
    return replace(recording, objects=(replace(track, **corners),))


class _Faulty:
    def read(self, found: RecordingFiles) -> Recording:
        return ALL[self.dataset][1](super().read(found))  # type: ignore[misc]


@dataclass(frozen=True)
class Faulty(_Faulty, CsvReader):
    """Its recordings are wrong."""


@dataclass(frozen=True)
class FaultyTracks(_Faulty, TrackedReader):
    """The same, with tracked objects."""


@dataclass(frozen=True)
class Searching(CsvReader):
    """Its find() does more than it should, or too little."""

    fault: str = ""

    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        found = super().find(root)
        if self.fault == "reads":
            for each in found:
                (each.folder / "body.csv").read_text("utf-8").splitlines()[100].split(",")[60]
        if self.fault == "names":
            return tuple(replace(each, recording_id=f"{Path(root).name}-{each.recording_id}") for each in found)
        if self.fault == "writes":
            (found[0].folder / f"index-{uuid.uuid4()}.json").write_text("{}")
        return found


@dataclass(frozen=True)
class Careless(CsvReader):
    """Its read() does not look at what it takes."""

    fault: str = ""

    def read(self, found: RecordingFiles) -> Recording:
        try:
            return super().read(found)
        except InputFileError:
            if self.fault == "crashes":
                raise ValueError("could not convert string to float") from None
        path = found.folder / "events.csv"
        whole = path.read_text("utf-8") if path.exists() else ""
        raise InputFileError(found.folder, "", expected="a recording", found=f"something else ({len(whole)})")


@dataclass
class Changeable:
    """A reader that is no frozen data class."""

    dataset: str = "changeable"
    options: object = CsvReader().options

    def find(self, root: Path | str) -> tuple[RecordingFiles, ...]:
        return replace(CsvReader(), dataset="changeable").find(root)

    def read(self, found: RecordingFiles) -> Recording:
        return replace(CsvReader(), dataset="changeable").read(found)


ALL = FAULTS | OF_TRACKS
READERS: dict[str, tuple[str, object]] = {
    **{name: (check, Faulty(name)) for name, (check, _) in FAULTS.items()},
    **{name: (check, FaultyTracks(name)) for name, (check, _) in OF_TRACKS.items()},
    "reads-in-find": ("damage", Searching("reads-in-find", fault="reads")),
    "names-by-root": ("find", Searching("names-by-root", fault="names")),
    "writes": ("untouched", Searching("writes", fault="writes")),
    "crashes": ("damage", Careless("crashes", fault="crashes")),
    "names-no-file": ("damage", Careless("names-no-file")),
    "changeable": ("manifest", Changeable()),
    "no-licence": ("manifest", CsvReader("no-licence")),
    "empty-licence": ("manifest", CsvReader("empty-licence")),
    "no-citation": ("manifest", CsvReader("no-citation")),
}
MANIFESTS = {
    "no-licence": ('licence = "CC BY 4.0"\n', ""),
    "empty-licence": ('licence = "CC BY 4.0"', 'licence = ""'),
    "no-citation": ("@misc{doe2026tabletop", "{Doe 2026"),
}
