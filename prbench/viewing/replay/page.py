"""Bodies, rays and goal of one sequence in viser's scene; each motion walks in a lane of its own."""

from __future__ import annotations

import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from prbench.errors import MissingExtraError
from prbench.files.storage import sole_writer, write_text
from prbench.geometry.skeleton import Joint
from prbench.shown import html
from prbench.viewing.figures import BOX_EDGES
from prbench.viewing.replay import scene as replay

if TYPE_CHECKING:
    from viser import ViserServer

Vector = Float[np.ndarray, "3"]

_HEAD_RADIUS = 0.07
_LONGEST_RAY = 6.0
_BETWEEN = 0.8  # metres between lanes
_LEAST_LANE = 1.0


def camera_of(scene: replay.Scene) -> tuple[Vector, Vector]:
    """Place a camera ahead of the bodies and to their side, far enough to see all lanes.

    Returns:
        Position of the camera, and the point that it looks at; canonical frame, metres.
    """
    lanes = lane_offsets(scene)
    pelvis = np.concatenate(
        [motion.joints[:, Joint.PELVIS] + lane for motion, lane in zip(scene.motions, lanes, strict=True)]
    )
    low = pelvis.min(axis=0)
    high = pelvis.max(axis=0)
    look_at = np.array([(low[0] + high[0]) / 2, 0.9, (low[2] + high[2]) / 2])
    across = np.cross([0.0, 1.0, 0.0], scene.picture_axis)
    # From ahead and a little from the side: the faces can be seen, and the lanes do not cover one another.
    away = 0.8 * scene.picture_axis - 0.6 * across
    distance = 2.2 + 0.75 * float(np.linalg.norm((high - low)[[0, 2]]))
    to_the_left = np.cross(away, [0.0, 1.0, 0.0]) * 0.15 * distance  # of the picture: the overlay stands there
    look_at = look_at + to_the_left
    return look_at + away * distance + [0.0, 0.25 * distance, 0.0], look_at


class PageStage:
    """The nodes of one sequence, hidden until its turn.

    Args:
        server: Server that keeps the scene.
        number: Number of the sequence on the page.
        scene: The sequence.
    """

    def __init__(self, server: ViserServer, number: int, scene: replay.Scene) -> None:
        self.root = server.scene.add_frame(f"/sequence_{number}", show_axes=False, visible=False)
        self._scene = scene
        self._bodies = [
            _Body(server, f"/sequence_{number}/motion_{lane}", scene, motion, offset)
            for lane, (motion, offset) in enumerate(zip(scene.motions, lane_offsets(scene), strict=True))
        ]
        # The clock stands above the middle of the first body's way.
        pelvis = scene.motions[0].joints[:, Joint.PELVIS]
        x, _, z = (pelvis.min(axis=0) + pelvis.max(axis=0)) / 2
        self._clock = server.scene.add_label(
            f"/sequence_{number}/clock", "", position=(x, 2.5, z), anchor="bottom-center"
        )

    def set_frame(self, frame: int) -> None:
        """Move everything to a frame."""
        for body in self._bodies:
            body.set_frame(frame)
        happens = replay.phase(self._scene, frame).strip()
        self._clock.text = f"{self._scene.title}: {frame / self._scene.fps:.2f} s{f' · {happens}' if happens else ''}"


class _Body:
    """One motion in its lane, with its rays and its own copy of the goal."""

    def __init__(
        self, server: ViserServer, name: str, scene: replay.Scene, motion: replay.ShownMotion, offset: Vector
    ) -> None:
        joints = motion.joints + offset
        goal = None if scene.goal is None else scene.goal.location + offset
        colour = replay.rgb(motion.colour)
        self._heads = joints[:, Joint.HEAD]
        self._head = server.scene.add_icosphere(f"{name}/head", radius=_HEAD_RADIUS, color=colour, subdivisions=2)
        bones = replay.bone_segments(joints)
        segments = {
            "right": (bones[:, replay.IS_THICK], colour, 0.03),
            "left": (bones[:, ~replay.IS_THICK], colour, 0.016),
            "head_ray": (replay.head_rays(joints, scene.head_tilt_deg, goal, _LONGEST_RAY)[:, None], colour, 0.008),
        }
        if motion.gaze is not None:
            origin = motion.gaze.origin + offset
            gaze = replay.rays(origin, motion.gaze.direction, goal, _LONGEST_RAY)
            # A ray without length where the gaze is not valid: the viewer shows no NaN.
            gaze = np.where(motion.gaze.valid[:, None, None], gaze, origin[:, None])
            segments["gaze"] = (gaze[:, None], replay.rgb(replay.GAZE_COLOUR), 0.012)
        self._moving = []
        for what, (ends, shade, width) in segments.items():
            positions = ends.astype(np.float32)
            handle = server.scene.add_line_segments(f"{name}/{what}", positions[0], colors=shade, thickness=width)
            self._moving.append((positions, handle))
        # Add the parts that do not move: label, path of the pelvis on the floor, and goal.
        floor = motion.joints[:, Joint.PELVIS] * [1.0, 0.0, 1.0] + offset + [0.0, 0.005, 0.0]
        way = np.stack([floor[:-1], floor[1:]], axis=1).astype(np.float32)
        server.scene.add_line_segments(f"{name}/way", way, colors=colour, thickness=0.012)
        server.scene.add_label(f"{name}/label", motion.label, position=tuple(floor[0]), anchor="top-center")
        if scene.goal is not None:
            # Every lane has its own copy of the goal, because its body reaches for that.
            edges = (scene.goal.box_corners + offset)[np.array(BOX_EDGES)].astype(np.float32)
            server.scene.add_line_segments(
                f"{name}/goal_box", edges, colors=replay.rgb(replay.BOX_COLOUR), thickness=0.01
            )
            place = tuple(scene.goal.location + offset)
            shade = replay.rgb(replay.GOAL_COLOUR)
            server.scene.add_icosphere(f"{name}/goal", radius=0.03, color=shade, subdivisions=2, position=place)

    def set_frame(self, frame: int) -> None:
        """Move the body to a frame."""
        self._head.position = self._heads[frame]
        for positions, handle in self._moving:
            handle.points = positions[frame]


def lane_offsets(scene: replay.Scene) -> Float[np.ndarray, "motions 3"]:
    """Return the offset of each motion's lane, metres: side by side, across the way to the goal, around the middle."""
    across = np.cross([0.0, 1.0, 0.0], scene.picture_axis)
    spans = [np.ptp(motion.joints[:, Joint.PELVIS] @ across) for motion in scene.motions]
    # As wide as the widest path, so that no body walks into its neighbour's lane.
    step = max(_LEAST_LANE, float(max(spans))) + _BETWEEN
    places = (np.arange(len(scene.motions)) - (len(scene.motions) - 1) / 2) * step
    return places[:, None] * across


# Seconds that the last frame of a sequence stays.
HOLD = 1.0


def write_page(scenes: Sequence[replay.Scene], path: Path, progress: replay.Progress) -> None:
    """Show sequences one after another on the time line of a 3-D viewer, and write the page.

    Args:
        scenes: Scenes to show.
        path: HTML to write; replaced when it exists.
        progress: Called after every frame.

    Raises:
        MissingExtraError: if viser is not installed.
        StorageError: if the file cannot be written.
    """
    with viewer() as server:
        # A floor at height 0, Y up, and a camera that sees the first sequence from the side of its goal.
        server.scene.set_up_direction("+y")
        greys: dict[str, Any] = {"cell_color": (228, 228, 228), "section_color": (200, 200, 200)}
        server.scene.add_grid("/floor", width=40.0, height=40.0, plane="xz", cell_size=0.5, section_size=1.0, **greys)
        place, look_at = camera_of(scenes[0])
        server.initial_camera.position = (float(place[0]), float(place[1]), float(place[2]))
        server.initial_camera.look_at = (float(look_at[0]), float(look_at[1]), float(look_at[2]))
        server.initial_camera.up = (0.0, 1.0, 0.0)
        stages = [PageStage(server, number, scene) for number, scene in enumerate(scenes)]
        # Every frame is set once, and the last one of each sequence held; viser records what changes.
        recording = server.get_scene_serializer()
        done = 0
        total = sum(scene.n_frames for scene in scenes)
        for scene, stage in zip(scenes, stages, strict=True):
            stage.root.visible = True
            for frame in range(scene.n_frames):
                stage.set_frame(frame)
                recording.insert_sleep(1.0 / scene.fps)
                done += 1
                progress(done, total, scene.sequence_id)
            recording.insert_sleep(HOLD)
            stage.root.visible = False
        page = recording.as_html()
    content = with_overlay(page, scenes, hold=HOLD)
    with sole_writer(path):
        write_text(path, content)


@contextmanager
def viewer() -> Iterator[ViserServer]:
    """Start viser's server, which keeps the scene; it listens on this machine only, while the page is made."""
    try:
        from viser import ViserServer
    except ModuleNotFoundError as error:
        raise MissingExtraError("viser", "view", "writing HTML") from error
    with redirect_stdout(io.StringIO()):  # it prints its address in spite of `verbose`; no user needs it
        server = ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        yield server
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def with_overlay(page: str, scenes: Sequence[replay.Scene], *, hold: float) -> str:
    """Put the overlay into a page: times and scores of each sequence, colours, and the notice of the licence.

    Args:
        page: A whole HTML document.
        scenes: Scenes that the page shows, in order.
        hold: Seconds that the last frame of each stays.
    """
    parts = []
    start = 0.0
    for scene in scenes:
        end = start + scene.n_frames / scene.fps
        when = f"{start:.1f} to {end:.1f} s, prime at {start + scene.prime_time:.1f} s"
        parts.append(f'<h2>{html(scene.title)} ({when})</h2><div class="id">{html(scene.sequence_id)}</div>')
        for motion in scene.motions:
            scores = html(replay.score_sentence(scene, motion) or "not scored")
            parts.append(f"<div>{swatch(motion.colour)}<b>{html(motion.label)}</b>: {scores}</div>")
        # The time line of the viewer runs through all sequences, each held at its end.
        start = end + hold
    key = [("bodies: right limbs and trunk thick, left limbs thin; thin ray: head forward", replay.MARK_COLOUR)]
    if any(motion.gaze is not None for scene in scenes for motion in scene.motions):
        key.append(("gaze", replay.GAZE_COLOUR))
    if any(scene.goal is not None for scene in scenes):
        key.append(("goal and its box", replay.GOAL_COLOUR))
    notices = dict.fromkeys(scene.notice for scene in scenes if scene.notice)
    notice = "".join(f'<p class="notice">{html(text)}</p>' for text in notices)
    lines = "".join(f"<div>{swatch(colour)}{html(text)}</div>" for text, colour in key)
    hint = "<div>Drag turns, wheel zooms, right drag moves; play and time line are the viewer's own.</div>"
    style = Path(__file__).with_name("page.css").read_text(encoding="utf-8")
    box = (
        f"<style>\n{style}</style>"
        f'<div id="prbench"><details open><summary>prbench view</summary>{notice}{lines}{hint}{"".join(parts)}'
        "</details></div>"
    )
    # The last one, in case the viewer's own scripts hold that text, too.
    cut = page.rindex("</body>")
    return f"{page[:cut]}{box}{page[cut:]}".replace("<title>Viser</title>", "<title>prbench view</title>", 1)


def swatch(colour: str) -> str:
    """Return a short line in a colour, as HTML."""
    return f'<span class="swatch" style="background:{colour}"></span>'
