"""Time rays and closest points on a mesh of the size of a scanned room, and measure their errors.

Run from the repository's root: ``python -m benchmarks.speed.bench_meshes [--rays 20000] [--threads 1]``. It needs the
extra ``open3d``. The rays of trimesh are timed beside it where ``embreex`` is installed. Some rays are compared with a
loop over all triangles in float64, and every other way with the first one on all rays.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.speed.timing import Row, print_rows, timed
from prbench.geometry.shapes import TriangleMesh, import_open3d

EXACT_RAYS = 100
"""Rays whose distances the slow loop computes."""
SURFACE_NOISE = 0.002
"""Metres by which the corners of the room are displaced, as a scanner's noise displaces them."""
FURNITURE = 20


@dataclass(frozen=True)
class Problem:
    """A mesh, and rays that begin at the height of a head."""

    vertices: np.ndarray
    faces: np.ndarray
    origins: np.ndarray
    directions: np.ndarray


def main() -> None:
    """Print one table of times and one of errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rays", type=int, default=20_000)
    parser.add_argument("--threads", type=int, default=1, help="of Open3D's own test of rays")
    options = parser.parse_args()
    problem = scanned_room(options.rays)
    reach = np.full(options.rays, np.inf)
    mesh = TriangleMesh(problem.vertices, problem.faces)
    ways: dict[str, Callable[[], np.ndarray]] = {
        "prbench: Open3D's triangle, distance in float64": lambda: mesh.first_hit(
            problem.origins, problem.directions, reach
        ),
        f"Open3D's own distance, {options.threads} thread(s)": single_precision(problem, options.threads),
    } | trimesh_ways(problem)
    exact, seconds = exact_distances(problem)
    ours = mesh.first_hit(problem.origins, problem.directions, reach)
    error = np.abs(ours[:EXACT_RAYS] - exact).max()
    rows = [Row(name, timed(way, 3)) for name, way in ways.items()]
    rows.append(Row(f"loop over all triangles (from {EXACT_RAYS} rays)", seconds))
    print_rows(f"{options.rays:,} rays, {len(problem.faces):,} triangles", rows)
    for row, way in zip(rows, ways.values(), strict=False):
        assert row.seconds is not None, "every way was timed"
        speed = options.rays / row.seconds
        print(f"{row.name}: {speed:,.0f} rays a second, at most {largest_difference(way(), ours):.1e} m from the first")
    print(f"the first way: at most {error:.1e} m from the loop over all triangles, on {EXACT_RAYS} rays")
    points = problem.origins
    closest = timed(lambda: mesh.distance(points), 3)
    print(f"closest points by prbench.geometry.shapes: {len(points) / closest:,.0f} points a second")


def scanned_room(n_rays: int) -> Problem:
    """A room of 8 m by 3 m by 6 m with furniture, about 330,000 triangles, at several metres from the origin."""
    rng = np.random.default_rng(0)
    parts = box_surface(np.array([-1.0, 0.0, -7.0]), np.array([8.0, 3.0, 6.0]), 158)
    for _ in range(FURNITURE):
        corner = rng.uniform([-1.0, 0.0, -7.0], [6.0, 1.5, -2.0])
        parts += box_surface(corner, rng.uniform(0.2, 1.0, 3), 12)
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + start for start, (_, faces) in zip(first, parts, strict=False)])
    directions = rng.normal(size=(n_rays, 3))
    return Problem(
        vertices=vertices + rng.normal(0, SURFACE_NOISE, vertices.shape),
        faces=faces,
        origins=rng.uniform([0.0, 1.2, -6.0], [6.0, 1.8, -2.0], (n_rays, 3)),
        directions=directions / np.linalg.norm(directions, axis=1, keepdims=True),
    )


def box_surface(corner: np.ndarray, size: np.ndarray, pieces: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Six sides, each cut into ``pieces`` times ``pieces`` squares of two triangles."""
    edges = np.diag(size)
    sides = []
    for axis in range(3):
        across, along, through = np.roll(edges, -axis, axis=0)
        for start in (corner, corner + through):
            sides.append(grid(start, across, along, pieces))
    return sides


def grid(start: np.ndarray, across: np.ndarray, along: np.ndarray, pieces: int) -> tuple[np.ndarray, np.ndarray]:
    """Corners and triangles of one side."""
    steps = np.linspace(0.0, 1.0, pieces + 1)
    first, second = np.meshgrid(steps, steps, indexing="ij")
    vertices = start + first[..., None] * across + second[..., None] * along
    row = pieces + 1
    square = (np.arange(pieces)[:, None] * row + np.arange(pieces)).ravel()
    lower = np.stack([square, square + row, square + 1], axis=1)
    upper = np.stack([square + 1, square + row, square + row + 1], axis=1)
    return vertices.reshape(-1, 3), np.concatenate([lower, upper])


def single_precision(problem: Problem, threads: int) -> Callable[[], np.ndarray]:
    """Open3D's float32 distances, the mesh where it stands."""
    open3d = import_open3d("bench_meshes")
    tensor = open3d.core.Tensor
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(problem.vertices.astype(np.float32)), tensor(problem.faces.astype(np.uint32)))
    rays = tensor(np.hstack([problem.origins, problem.directions]).astype(np.float32))
    return lambda: scene.cast_rays(rays, nthreads=threads)["t_hit"].numpy().astype(np.float64)


def trimesh_ways(problem: Problem) -> dict[str, Callable[[], np.ndarray]]:
    """The rays of trimesh by Embree, where ``embreex`` is installed."""
    if importlib.util.find_spec("embreex") is None:
        return {}
    import trimesh
    from trimesh.ray.ray_pyembree import RayMeshIntersector

    intersector = RayMeshIntersector(trimesh.Trimesh(problem.vertices, problem.faces, process=False))

    def cast() -> np.ndarray:
        places, rays, _ = intersector.intersects_location(problem.origins, problem.directions, multiple_hits=False)
        distance = np.full(len(problem.origins), np.inf)
        distance[rays] = np.linalg.norm(places - problem.origins[rays], axis=1)
        return distance

    return {"trimesh with embreex": cast}


def largest_difference(one: np.ndarray, other: np.ndarray) -> float:
    """Return the largest difference in metres; inf where one ray hits a triangle and the other does not."""
    both_miss = np.isinf(one) & np.isinf(other)
    return float(np.abs(one[~both_miss] - other[~both_miss]).max(initial=0.0))


def exact_distances(problem: Problem) -> tuple[np.ndarray, float]:
    """Distances of the first rays in float64, and the seconds that all rays would take."""
    corners = problem.vertices[problem.faces]
    start = time.perf_counter()
    rays = zip(problem.origins[:EXACT_RAYS], problem.directions[:EXACT_RAYS], strict=True)
    found = np.array([exact_distance(origin, direction, corners) for origin, direction in rays])
    return found, (time.perf_counter() - start) * len(problem.origins) / EXACT_RAYS


def exact_distance(origin: np.ndarray, direction: np.ndarray, corners: np.ndarray) -> float:
    """One ray against every triangle (Möller and Trumbore, 1997)."""
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    across = np.cross(direction, second)
    volume = np.einsum("fc,fc->f", first, across)
    from_corner = origin - corners[:, 0]
    sideways = np.cross(from_corner, first)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("fc,fc->f", from_corner, across) / volume
        v = sideways @ direction / volume
        along = np.einsum("fc,fc->f", second, sideways) / volume
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (along > 0)
    return float(along[hit].min(initial=np.inf))


if __name__ == "__main__":
    main()
