"""Gaze rays, boxes and triangle meshes.

Rays against axis-aligned boxes follow equations 4 to 7 of *Prime and Reach*: the slab test and the near miss.
Both functions test every ray against every box at once. Degenerate cases are defined, never NaN:

* A direction component of zero leaves that slab without constraint when the origin lies inside it (borders
  included), and misses the box when it does not.
* A box of zero size is a point; equation 4 asks for ``t_near < t_far``, so a point is never *hit*, but it can be
  nearly missed, at the distance between the point and the ray.
* A closest point inside the box, the centre included, is at distance 0.

Triangle meshes are asked through Open3D's ``RaycastingScene`` (extra ``open3d``). Open3D computes in float32, which
erred by up to 28 µm in a room of 8 m. It is therefore asked for the triangle alone: the distance to that triangle is
computed from its corners in float64. ``benchmarks/speed/bench_meshes.py`` measures the error of both, and the speed
beside other libraries.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from prbench.errors import MissingExtraError, UnloadableExtraError

Points = Float[np.ndarray, "n 3"]
Corners = Float[np.ndarray, "m 3"]


@dataclass(frozen=True)
class SlabHits:
    """Result of the slab test for n rays and m boxes.

    Attributes:
        near: Distance along the ray to the last slab entered; negative if the origin lies beyond it, inf for a miss.
        far: Distance along the ray to the first slab left; -inf for a miss.
        hit: ``near < far`` and ``far >= 0`` (equation 4).
    """

    near: Float[np.ndarray, "n m"]
    far: Float[np.ndarray, "n m"]
    hit: Bool[np.ndarray, "n m"]


def slab_test(origins: Points, directions: Points, box_min: Corners, box_max: Corners) -> SlabHits:
    """Intersect n rays with m axis-aligned boxes (equation 4).

    Args:
        origins: Ray origins, metres; same frame as the boxes.
        directions: Unit directions; their length is the unit of the returned distances.
        box_min: Lower corners of the boxes.
        box_max: Upper corners of the boxes.
    """
    n = len(origins)
    m = len(box_min)
    near = np.full((n, m), -np.inf)
    far = np.full((n, m), np.inf)
    entry = np.empty((n, m))
    leave = np.empty((n, m))
    for axis in range(3):
        origin = origins[:, axis, None]
        direction = directions[:, axis, None]
        parallel = direction[:, 0] == 0
        # Rows with a direction of 0 are overwritten below; here they only must not divide by it.
        inverse = 1.0 / np.where(direction == 0, 1.0, direction)
        np.subtract(box_min[None, :, axis], origin, out=entry)
        np.subtract(box_max[None, :, axis], origin, out=leave)
        inside = (entry[parallel] <= 0) & (leave[parallel] >= 0)
        entry *= inverse
        leave *= inverse
        backwards = direction[:, 0] < 0
        if backwards.any():
            entry[backwards], leave[backwards] = leave[backwards], entry[backwards]
        if parallel.any():
            entry[parallel] = np.where(inside, -np.inf, np.inf)
            leave[parallel] = np.where(inside, np.inf, -np.inf)
        np.maximum(near, entry, out=near)
        np.minimum(far, leave, out=far)
    return SlabHits(near, far, (near < far) & (far >= 0))


@dataclass(frozen=True)
class NearMisses:
    """Result of the proximity check for n rays and m boxes.

    Attributes:
        distance: Distance from the ray's closest point to the box, measured towards its centre, metres (delta of
            equation 7).
        along: Position of the closest point on the ray (t_closest of equation 5); negative behind the origin.
    """

    distance: Float[np.ndarray, "n m"]
    along: Float[np.ndarray, "n m"]


def near_miss(origins: Points, directions: Points, box_min: Corners, box_max: Corners) -> NearMisses:
    """Compute how closely n rays pass m boxes (equations 5 to 7).

    The closest point is the one nearest to the box *centre*; from it a second ray runs to the centre, and the distance
    is the stretch of that ray before it enters the box.

    Args:
        origins: Ray origins, metres; same frame as the boxes.
        directions: Unit directions.
        box_min: Lower corners.
        box_max: Upper corners.
    """
    centre = (box_min + box_max) / 2
    half = (box_max - box_min) / 2
    offset = centre[None] - origins[:, None]  # (n, m, 3)
    # Equation 5.
    along = np.einsum("nmk,nk->nm", offset, directions)
    to_centre = offset - along[..., None] * directions[:, None]
    length = np.linalg.norm(to_centre, axis=-1)
    # The ray from the centre towards the closest point leaves the box after min_i half_i / |d_i|; an axis along which
    # it does not move is no constraint.
    component = np.abs(to_centre)
    ratio = np.divide(half[None], component, out=np.full_like(component, np.inf), where=component > 0).min(axis=-1)
    inside_length = np.where(np.isfinite(ratio), ratio, 0.0) * length
    # Equation 7; a closest point inside the box is at distance 0.
    return NearMisses(np.maximum(length - inside_length, 0.0), along)


def ray_distances(
    origins: Points, directions: Points, box_min: Corners, box_max: Corners
) -> tuple[Float[np.ndarray, "n m"], Bool[np.ndarray, "n m"]]:
    """Return how far each ray passes each box, and whether it hits it (equations 4 to 7).

    Args:
        origins: Ray origins, metres; same frame as the boxes.
        directions: Unit vectors.
        box_min: Lower corners.
        box_max: Upper corners.

    Returns:
        Distances (n, m), metres: 0 of a hit, infinite of a ray that points away; and hits (n, m).
    """
    hit = slab_test(origins, directions, box_min, box_max).hit
    misses = near_miss(origins, directions, box_min, box_max)
    # A ray that points away passes the box behind the eye, which is no look at it.
    return np.where(hit, 0.0, np.where(misses.along >= 0, misses.distance, np.inf)), hit


@dataclass(frozen=True, eq=False)
class Boxes:
    """The boxes of n sequences one after the other; box of row i are ``offsets[i]`` to ``offsets[i + 1] - 1``. Metres.

    Each sequence's boxes stand in that sequence's own frame.

    Attributes:
        rotation: Turns a vector of the box's own frame into the frame of the sequence.
        half_extents: Half the length of the edges along the box's own axes.

    Raises:
        ValueError: if the arrays do not belong together.
    """

    centre: Float[np.ndarray, "boxes 3"]
    rotation: Float[np.ndarray, "boxes 3 3"]
    half_extents: Float[np.ndarray, "boxes 3"]
    offsets: Int[np.ndarray, " n_and_1"]

    def __post_init__(self) -> None:
        count = len(self.centre)
        shapes = (self.centre.shape, self.rotation.shape, self.half_extents.shape)
        if shapes != ((count, 3), (count, 3, 3), (count, 3)):
            raise ValueError(f"expected centres, rotations and half extents of as many boxes, found {shapes}")
        if self.offsets[0] != 0 or self.offsets[-1] != count or (np.diff(self.offsets) < 0).any():
            raise ValueError(f"offsets must rise from 0 to {count}, found {self.offsets.tolist()}")

    def __len__(self) -> int:
        """Return the number of sequences."""
        return len(self.offsets) - 1

    @classmethod
    def joined(cls, parts: list[Boxes]) -> Boxes:
        """Join the boxes of several sequences, in the order given."""
        sizes = [np.diff(part.offsets) for part in parts]
        return cls(
            np.concatenate([np.empty((0, 3)), *(part.centre for part in parts)]),
            np.concatenate([np.empty((0, 3, 3)), *(part.rotation for part in parts)]),
            np.concatenate([np.empty((0, 3)), *(part.half_extents for part in parts)]),
            np.concatenate([[0], np.cumsum(np.concatenate([np.empty(0, dtype=np.int64), *sizes]))]).astype(np.int64),
        )

    def part(self, start: int, stop: int) -> Boxes:
        """Return the boxes of the sequences ``start`` to ``stop - 1``, without copying."""
        offsets = self.offsets[start : stop + 1]
        own = slice(offsets[0], offsets[-1])
        return Boxes(self.centre[own], self.rotation[own], self.half_extents[own], offsets - offsets[0])

    def chosen(self, keep: Bool[np.ndarray, " boxes"]) -> Boxes:
        """Return the boxes where ``keep`` is true, each still with its sequence."""
        before = np.concatenate([[0], np.cumsum(keep)])
        return Boxes(self.centre[keep], self.rotation[keep], self.half_extents[keep], before[self.offsets])

    def of_rows(self, rows: Int[np.ndarray, " m"]) -> Boxes:
        """Return the boxes of some sequences, in the order given (copies)."""
        return Boxes.joined([self.part(int(row), int(row) + 1) for row in rows])

    def placed(self, transform: Float[np.ndarray, "4 4"]) -> Boxes:
        """Return the boxes in another frame.

        Args:
            transform: Maps points of the present frame into the other one; rigid.
        """
        turn = transform[:3, :3]
        return Boxes(self.centre @ turn.T + transform[:3, 3], turn @ self.rotation, self.half_extents, self.offsets)

    def depth(self, points: Float[np.ndarray, "points 3"]) -> Float[np.ndarray, "points boxes"]:
        """How deep each point lies in each box: the distance to the nearest side; negative outside. Metres.

        Args:
            points: Points in the frame of the boxes.
        """
        local = np.einsum("pbi,bij->pbj", points[:, None] - self.centre, self.rotation)
        return (self.half_extents - np.abs(local)).min(axis=-1)

    def reached(self, points: Float[np.ndarray, "points 3"]) -> Bool[np.ndarray, " boxes"]:
        """Return the boxes that come into the space that the points span along the axes; no other one holds a point."""
        reach = (np.abs(self.rotation) * self.half_extents[:, None]).sum(axis=-1)
        low = points.min(axis=0)
        return ((self.centre + reach >= low) & (self.centre - reach <= points.max(axis=0))).all(axis=1)


def deepest(points: Float[np.ndarray, "frames joints 3"], boxes: Boxes) -> Float[np.ndarray, " frames"]:
    """Largest depth of any joint in any box in each frame, metres; 0 where no joint is in a box.

    Args:
        points: One motion.
        boxes: Boxes in the frame of the motion.
    """
    flat = points.reshape(-1, 3)
    near = boxes.chosen(boxes.reached(flat))
    largest = np.zeros(len(flat))
    # One box after the other: a scene of hundreds of boxes needs no more memory than one.
    for number in range(len(near.centre)):
        own = slice(number, number + 1)
        one = Boxes(near.centre[own], near.rotation[own], near.half_extents[own], np.array([0, 1]))
        np.maximum(largest, one.depth(flat)[:, 0], out=largest)
    return largest.reshape(points.shape[:2]).max(axis=1)


def import_open3d(purpose: str) -> Any:
    """Import Open3D.

    Args:
        purpose: What needs it, for the message.

    Raises:
        MissingExtraError: if it is not installed, with the line that installs it.
        UnloadableExtraError: if it is installed and cannot be loaded.
    """
    try:
        return importlib.import_module("open3d")
    except ModuleNotFoundError as error:
        raise MissingExtraError("open3d", "open3d", purpose) from error
    except ImportError as error:
        # The wheels expect some libraries of a desktop system, which images for servers leave out.
        remedy = "On Debian and Ubuntu: apt-get install libusb-1.0-0 libgl1 libgomp1 libx11-6"
        raise UnloadableExtraError("open3d", purpose, str(error), remedy) from error


class TriangleMesh:
    """One triangle mesh, prepared for closest points.

    Args:
        vertices: Corners, metres. Points are given in the same frame.
        faces: Three rows of ``vertices`` for each triangle.

    Raises:
        MissingExtraError: if Open3D is not installed.
    """

    def __init__(self, vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]) -> None:
        open3d = import_open3d("measuring distances to meshes")
        self._tensor = open3d.core.Tensor
        self._corners = vertices.astype(np.float64)[faces]
        # float32 is finest around the origin, so the mesh is moved there.
        self._centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        self._scene = open3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._single(vertices), self._tensor(faces.astype(np.uint32)))

    def distance(self, points: Points) -> Float[np.ndarray, " n"]:
        """Distance of each point to the closest point of the surface, metres; points inside a body are not negative."""
        found = self._scene.compute_closest_points(self._single(points))
        corners = self._corners[found["primitive_ids"].numpy()]
        first, second = found["primitive_uvs"].numpy().astype(np.float64).T[..., None]
        closest = corners[:, 0] * (1 - first - second) + corners[:, 1] * first + corners[:, 2] * second
        return np.linalg.norm(points - closest, axis=1)

    def _single(self, points: Points) -> Any:
        """Points around the mesh's centre as a float32 tensor."""
        return self._tensor((points - self._centre).astype(np.float32))
