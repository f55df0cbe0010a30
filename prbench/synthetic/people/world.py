"""Rooms: furniture around a free floor, objects that never move, and spots to put things.

Source: docs/specification/synthetic-recordings.md#world. The free floor of a room is a rectangle around the origin; the
front edges of the furniture lie on its border, so that straight walks are free of obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from prbench.randomness import named_generator
from prbench.synthetic import GENERATOR_VERSION
from prbench.synthetic.people.kinematics import UP
from prbench.synthetic.people.person import ObjectKind, Preset, SurfaceKind
from prbench.synthetic.performance import World

Vector = Float[np.ndarray, "3"]  # metres

_SEATED_TABLE_HEIGHT = 0.74
_DEEPEST_SPOT = 0.38


@dataclass(frozen=True)
class Surface:
    """A place to put things, along one wall of the free floor.

    Attributes:
        edge_centre: Middle of the front edge, at the height of the surface.
        normal: Horizontal, from the surface to the person before it.
        weight: Share of the room's goals on this surface.
    """

    kind: SurfaceKind
    edge_centre: Vector
    normal: Vector
    width: float
    weight: float

    @property
    def height(self) -> float:
        """Height of the surface, metres."""
        return float(self.edge_centre[1])

    @property
    def facing(self) -> float:
        """Heading of a person who faces the surface, radians."""
        return float(np.arctan2(-self.normal[0], -self.normal[2]))

    @property
    def left(self) -> Vector:
        """Unit vector along the edge, to the left of a person who faces the surface."""
        return np.cross(UP, -self.normal)

    def point(self, lateral: float, depth: float) -> Vector:
        """Return the point ``lateral`` to the left of the middle and ``depth`` behind the front edge."""
        return self.edge_centre + lateral * self.left - depth * self.normal


@dataclass(frozen=True)
class Item:
    """One object: its kind, its box, and where it stands at first.

    Attributes:
        position: Centre of the box.
        rides_on: Index of the object on which this one is carried.
    """

    kind: ObjectKind
    half_extents: Vector
    position: Vector
    yaw: float
    hinged: bool = False
    rides_on: int | None = None


@dataclass(frozen=True)
class Room:
    """The furniture of one room and the objects in it that never move."""

    room_id: str
    floor: tuple[float, float]
    surfaces: tuple[Surface, ...]
    bystanders: tuple[Item, ...]


def draw_room(preset: Preset, room_id: str, rng: np.random.Generator, n_bystanders: int | None = None) -> Room:
    """Furnish one room.

    Args:
        preset: Whose room.
        room_id: Its name.
        rng: The room's own generator.
        n_bystanders: Objects that never move; drawn between 3 and 12 if None.
    """
    surfaces = _draw_surfaces(preset, rng)
    drawn = int(rng.integers(3, 13))
    items: list[Item] = []
    for number in range(drawn if n_bystanders is None else n_bystanders):
        # Draw a place on the furniture; beyond a dozen, on boards above it, out of everybody's way.
        kind = preset.objects[int(rng.integers(len(preset.objects)))]
        half_extents, yaw = draw_item_shape(kind, rng)
        level = number // 12
        position = np.zeros(3)
        for _ in range(20):
            surface = surfaces[int(rng.integers(len(surfaces)))]
            position = draw_spot(surface, half_extents, yaw, rng) + (level > 0) * (1.0 + 0.22 * level) * UP
            if all(np.linalg.norm(position - item.position) > 0.2 for item in items):
                break
        items.append(Item(kind, half_extents, position, yaw))
    return Room(room_id, preset.room, surfaces, tuple(items))


def seated(room: Room, rng: np.random.Generator) -> Room:
    """Return the same room with its one table lowered for a person who sits at it."""
    height = _SEATED_TABLE_HEIGHT + 0.04 * float(rng.standard_normal())
    drop = np.array([0.0, room.surfaces[0].height - height, 0.0])
    surfaces = tuple(replace(surface, edge_centre=surface.edge_centre - drop) for surface in room.surfaces)
    bystanders = tuple(replace(item, position=item.position - drop) for item in room.bystanders)
    return replace(room, surfaces=surfaces, bystanders=bystanders)


def draw_item_shape(kind: ObjectKind, rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """Draw half extents of an object's box and its yaw."""
    drawn = np.array([rng.uniform(0.025, 0.06), rng.uniform(0.03, 0.10), rng.uniform(0.025, 0.06)])
    yaw = float(rng.uniform(-np.pi, np.pi))
    return (drawn if kind.half_extents is None else np.array(kind.half_extents)), yaw


def world_half_extents(half_extents: Vector, yaw: float) -> Vector:
    """Return half extents of the world-aligned box around a box turned by ``yaw``."""
    cosine = abs(np.cos(yaw))
    sine = abs(np.sin(yaw))
    x, y, z = half_extents
    return np.array([cosine * x + sine * z, y, sine * x + cosine * z])


def draw_spot(
    surface: Surface, half: Vector, yaw: float, rng: np.random.Generator, around: tuple[float, float] | None = None
) -> Vector:
    """Draw the centre of a box that stands on a free spot of a surface.

    Args:
        surface: Surface on which the object stands.
        half: Half extents of the box, in its own frame.
        yaw: Heading of the box.
        rng: Generator.
        around: Lateral position of the previous spot and the spread around it; the whole width if None.
    """
    half_depth = float(np.abs(world_half_extents(half, yaw) @ np.abs(surface.normal)))
    deepest = min(_DEEPEST_SPOT, surface.kind.depth - 0.04)
    depth = rng.uniform(min(0.05 + half_depth, deepest), deepest)
    reach = surface.width / 2.0 - 0.03
    lateral = rng.uniform(-reach, reach) if around is None else np.clip(rng.normal(*around), -reach, reach)
    return surface.point(float(lateral), float(depth)) + half[1] * UP


def _draw_surfaces(preset: Preset, rng: np.random.Generator) -> tuple[Surface, ...]:
    # Draw one surface of each kind, as far as there is room, and the others by weight.
    weights = np.array([kind.weight for kind in preset.surfaces])
    first = rng.permutation(len(preset.surfaces))
    rest = rng.choice(len(preset.surfaces), preset.n_surfaces, p=weights / weights.sum())
    kinds = [preset.surfaces[i] for i in (*first, *rest)][: preset.n_surfaces]
    surfaces: list[Surface] = []
    for number, kind in enumerate(kinds):
        height = kind.height + 0.04 * float(rng.standard_normal())
        weight = kind.weight / sum(other is kind for other in kinds)
        wall = number % 4
        normal = np.array([(0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)][wall])
        across, along = (preset.room[1], preset.room[0]) if wall % 2 == 0 else preset.room
        middle = -normal * across / 2.0 + height * UP
        width = 1.4 if preset.table_only else float(rng.uniform(0.7, 1.3))
        surface = Surface(kind, middle, normal, width, weight)
        # Shift it along its wall, narrower with each try, until it stands beside the others there.
        for _ in range(0 if preset.table_only else 60):
            shift = float(rng.uniform(-0.5, 0.5)) * (along - width)
            surface = replace(surface, edge_centre=middle + shift * surface.left, width=width)
            apart = [(abs(float((surface.edge_centre - other.edge_centre) @ surface.left)), other.width)
                     for other in surfaces[wall::4]]  # fmt: skip
            if all(distance >= (width + other) / 2.0 + 0.05 for distance, other in apart):
                break
            width = max(0.5, 0.97 * width)
        surfaces.append(surface)
    return tuple(surfaces)


_TEST_SHARE = 0.30
_VALIDATION_SHARE = 0.10

Split = Literal["train", "validation", "test"]

_PEOPLE = {"default": 24, "large": 400, "second": 24}
_ROOMS = {"default": 12, "large": 200, "second": 12}


@dataclass(frozen=True)
class Source:
    """Names every generator of one preset and world."""

    seed: int
    preset: str
    world: World

    def generator(self, kind: str, index: int, purpose: str) -> np.random.Generator:
        """Return the stream of one thing and one purpose; independent of every other."""
        world = ("prbench-synth", GENERATOR_VERSION, self.seed, self.preset, self.world)
        return named_generator(*world, kind, index, purpose)


def assign(source: Source, index: int) -> tuple[int, int, Split]:
    """Draw the side of the split, then room and person; those of the test side are kept out of training.

    Args:
        source: Seed, preset and world.
        index: Number of the recording.

    Returns:
        Numbers of the room and the person, and the split.
    """
    rng = source.generator("recording", index, "split")
    is_test = rng.random() < _TEST_SHARE
    # All people and rooms of the world in the order of a hash, of which the first are those of the test side.
    people, rooms = (
        [int(number) for number in source.generator(kind, 0, "rank").permutation(counts[source.world])]
        for kind, counts in (("person", _PEOPLE), ("room", _ROOMS))
    )
    n_test_people = round(_TEST_SHARE * len(people))
    n_test_rooms = round(_TEST_SHARE * len(rooms))
    people_here = people[:n_test_people] if is_test else people[n_test_people:]
    rooms_here = rooms[:n_test_rooms] if is_test else rooms[n_test_rooms:]
    person = people_here[int(rng.integers(len(people_here)))]
    room = rooms_here[int(rng.integers(len(rooms_here)))]
    if is_test:
        return room, person, "test"
    for_validation = people[n_test_people : n_test_people + round(_VALIDATION_SHARE * len(people))]
    return room, person, "validation" if person in for_validation else "train"
