"""Bodies, rays and goal of one sequence in viser's scene; each motion walks in a lane of its own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from prbench.geometry.skeleton import Joint
from prbench.viewing.figures import BOX_EDGES
from prbench.viewing.replay.measures import phase
from prbench.viewing.replay.parts import (
    BOX_COLOUR,
    GAZE_COLOUR,
    GOAL_COLOUR,
    IS_THICK,
    SURROUNDINGS_COLOUR,
    bone_segments,
    head_rays,
    rays,
    rgb,
)
from prbench.viewing.replay.scene import Scene, ShownMotion

if TYPE_CHECKING:
    from viser import ViserServer

_HEAD_RADIUS = 0.07
_LONGEST_RAY = 6.0
_BETWEEN = 0.8  # metres between lanes
_LEAST_LANE = 1.0


def set_up_scene(server: ViserServer, scenes: Sequence[Scene]) -> None:
    """Add a floor, and a camera that sees the first sequence from the side of its goal."""
    set_up_floor(server)
    place_camera(server, *camera_of(scenes[0]))


def set_up_floor(server: ViserServer) -> None:
    """Add a floor at height 0, and let Y point up."""
    server.scene.set_up_direction("+y")
    server.scene.add_grid(
        "/floor",
        width=40.0,
        height=40.0,
        plane="xz",
        cell_size=0.5,
        section_size=1.0,
        cell_color=(228, 228, 228),
        section_color=(200, 200, 200),
    )


def place_camera(server: ViserServer, place: Float[np.ndarray, "3"], look_at: Float[np.ndarray, "3"]) -> None:
    """Put the camera that a page opens with."""
    server.initial_camera.position = (float(place[0]), float(place[1]), float(place[2]))
    server.initial_camera.look_at = (float(look_at[0]), float(look_at[1]), float(look_at[2]))
    server.initial_camera.up = (0.0, 1.0, 0.0)


def camera_of(scene: Scene) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
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

    def __init__(self, server: ViserServer, number: int, scene: Scene) -> None:
        self._root = server.scene.add_frame(f"/sequence_{number}", show_axes=False, visible=False)
        self._scene = scene
        self._bodies = [
            _Body(server, f"/sequence_{number}/motion_{lane}", scene, motion, offset)
            for lane, (motion, offset) in enumerate(zip(scene.motions, lane_offsets(scene), strict=True))
        ]
        self._clock = server.scene.add_label(
            f"/sequence_{number}/clock", "", position=tuple(self._above()), anchor="bottom-center"
        )

    def show(self, visible: bool) -> None:
        """Let the sequence appear or vanish."""
        self._root.visible = visible

    def set_frame(self, frame: int) -> None:
        """Move everything to a frame."""
        for body in self._bodies:
            body.set_frame(frame)
        happens = phase(self._scene, frame).strip()
        self._clock.text = f"{self._scene.title}: {frame / self._scene.fps:.2f} s{f' · {happens}' if happens else ''}"

    def _above(self) -> Float[np.ndarray, "3"]:
        pelvis = self._scene.motions[0].joints[:, Joint.PELVIS]
        middle = (pelvis.min(axis=0) + pelvis.max(axis=0)) / 2
        return np.array([middle[0], 2.5, middle[2]])


class _Body:
    """One motion in its lane, with its rays and its own copy of the goal."""

    def __init__(
        self, server: ViserServer, name: str, scene: Scene, motion: ShownMotion, offset: Float[np.ndarray, "3"]
    ) -> None:
        joints = motion.joints + offset
        goal = None if scene.goal is None else scene.goal.location + offset
        colour = rgb(motion.colour)
        self._heads = joints[:, Joint.HEAD]
        self._head = server.scene.add_icosphere(f"{name}/head", radius=_HEAD_RADIUS, color=colour, subdivisions=2)
        bones = bone_segments(joints)
        segments = {
            "right": (bones[:, IS_THICK], colour, 0.03),
            "left": (bones[:, ~IS_THICK], colour, 0.016),
            "head_ray": (head_rays(joints, scene.head_tilt_deg, goal, _LONGEST_RAY)[:, None], colour, 0.008),
        }
        if motion.gaze is not None:
            origin = motion.gaze.origin + offset
            gaze = rays(origin, motion.gaze.direction, goal, _LONGEST_RAY)
            # A ray without length where the gaze is not valid: the viewer shows no NaN.
            gaze = np.where(motion.gaze.valid[:, None, None], gaze, origin[:, None])
            segments["gaze"] = (gaze[:, None], rgb(GAZE_COLOUR), 0.012)
        self._moving = [
            (
                positions.astype(np.float32),
                server.scene.add_line_segments(
                    f"{name}/{what}", positions[0].astype(np.float32), colors=shade, thickness=width
                ),
            )
            for what, (positions, shade, width) in segments.items()
        ]
        _add_still(server, name, scene, motion, offset)

    def set_frame(self, frame: int) -> None:
        """Move the body to a frame."""
        self._head.position = self._heads[frame]
        for positions, handle in self._moving:
            handle.points = positions[frame]


def _add_still(
    server: ViserServer, name: str, scene: Scene, motion: ShownMotion, offset: Float[np.ndarray, "3"]
) -> None:
    """Add the parts that do not move: label, path of the pelvis on the floor, surroundings and goal."""
    colour = rgb(motion.colour)
    floor = motion.joints[:, Joint.PELVIS] * [1.0, 0.0, 1.0] + offset + [0.0, 0.005, 0.0]
    way = np.stack([floor[:-1], floor[1:]], axis=1).astype(np.float32)
    server.scene.add_line_segments(f"{name}/way", way, colors=colour, thickness=0.012)
    server.scene.add_label(f"{name}/label", motion.label, position=tuple(floor[0]), anchor="top-center")
    if scene.surroundings is not None and motion is scene.motions[0]:  # copies in every lane would overlap
        server.scene.add_point_cloud(
            f"{name}/surroundings",
            (scene.surroundings + offset).astype(np.float32),
            colors=rgb(SURROUNDINGS_COLOUR),
            point_size=0.012,
        )
    if scene.goal is not None:
        # Every lane has its own copy of the goal, because its body reaches for that.
        edges = (scene.goal.box_corners + offset)[np.array(BOX_EDGES)].astype(np.float32)
        server.scene.add_line_segments(f"{name}/goal_box", edges, colors=rgb(BOX_COLOUR), thickness=0.01)
        server.scene.add_icosphere(
            f"{name}/goal",
            radius=0.03,
            color=rgb(GOAL_COLOUR),
            subdivisions=2,
            position=tuple(scene.goal.location + offset),
        )


def lane_offsets(scene: Scene) -> Float[np.ndarray, "motions 3"]:
    """Return the offset of each motion's lane, metres: side by side, across the way to the goal, around the middle."""
    across = np.cross([0.0, 1.0, 0.0], scene.picture_axis)
    spans = [np.ptp(motion.joints[:, Joint.PELVIS] @ across) for motion in scene.motions]
    # As wide as the widest path, so that no body walks into its neighbour's lane.
    step = max(_LEAST_LANE, float(max(spans))) + _BETWEEN
    places = (np.arange(len(scene.motions)) - (len(scene.motions) - 1) / 2) * step
    return places[:, None] * across
