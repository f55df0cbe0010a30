"""Gaze points of GIMO: PLY files, and when a frame has none."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from prbench.readers.gimo.gaze import read_gaze, read_vertices
from prbench.readers.gimo.synthetic import ply_bytes

POINT = np.array([[0.25, -1.5, 3.0], [9.0, 9.0, 9.0]])


def files(folder, **frames: np.ndarray | None) -> tuple[dict, dict]:
    """Both files of some frames (``f7``); None leaves the centre out."""
    cones, centres = {}, {}
    for name, point in frames.items():
        frame = int(name[1:])
        cones[frame] = folder / f"{frame}.ply"
        cones[frame].write_bytes(ply_bytes(np.ones((5, 3))))
        if point is not None:
            centres[frame] = folder / f"{frame}_center.ply"
            centres[frame].write_bytes(ply_bytes(point))
    return cones, centres


def test_the_first_vertex_is_the_gaze_point(tmp_path) -> None:
    gaze, remarks = read_gaze(*files(tmp_path, f7=POINT, f12=POINT[::-1]))
    assert gaze.frames.tolist() == [7, 12]
    np.testing.assert_array_equal(gaze.points, [[0.25, -1.5, 3.0], [9.0, 9.0, 9.0]])
    assert remarks == ()


def test_frames_without_a_point_are_left_out(tmp_path) -> None:
    cones, centres = files(tmp_path, f1=None, f2=POINT, f3=np.zeros((2, 3)), f4=np.zeros((0, 3)), f5=POINT * np.nan)
    cones[2].write_bytes(ply_bytes(np.zeros((0, 3))))
    gaze, remarks = read_gaze(cones, centres)
    assert (len(gaze.frames), gaze.points.shape, remarks) == (0, (0, 3), ())


def test_a_cut_file_costs_one_frame_and_a_word(tmp_path) -> None:
    cones, centres = files(tmp_path, f1=POINT, f2=POINT)
    centres[1].write_bytes(centres[1].read_bytes()[:-60])
    gaze, remarks = read_gaze(cones, centres)
    assert gaze.frames.tolist() == [2]
    assert remarks[0].startswith("1 damaged gaze files are left out, first: ")
    assert "expected 2 vertices, found fewer bytes than that" in remarks[0]


@pytest.mark.parametrize("form", ["binary_little_endian", "binary_big_endian"])
def test_vertices_of_every_format_with_properties_in_any_order(tmp_path, form) -> None:
    header = f"ply\nformat {form} 1.0\ncomment x\nelement vertex 2\nproperty uchar red\nproperty float y\n"
    header += (
        "property float x\nproperty double z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [(200, 1.5, -2.5, 4.0), (7, 0.5, 8.0, 0.25)]
    body = b"".join(struct.pack(("<" if "little" in form else ">") + "Bffd", *row) for row in rows)
    path = tmp_path / "a.ply"
    path.write_bytes(header.encode() + body)
    np.testing.assert_array_equal(read_vertices(path), [[-2.5, 1.5, 4.0], [8.0, 0.5, 0.25]])
