"""HOT3D's own toolkit opens the files that we write, and poses hands as we do.

The toolkit is no package: clone github.com/facebookresearch/hot3d, install projectaria-tools, and set
PRBENCH_HOT3D_TOOLKIT to the clone.
"""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

from prbench.readers.hot3d import READER, read_readings
from prbench.readers.hot3d import format as hot3d
from prbench.readers.hot3d import hands as umetrack
from prbench.synthetic.write_tree import synthesize_tree

pytest.importorskip("projectaria_tools", reason="the official reader is not installed")
TOOLKIT = os.environ.get("PRBENCH_HOT3D_TOOLKIT", "")
if not TOOLKIT:
    pytest.skip("set PRBENCH_HOT3D_TOOLKIT to a clone of the HOT3D toolkit", allow_module_level=True)


@pytest.fixture(scope="module")
def official() -> Any:
    """Imports a module of the toolkit by name."""
    folder = str(Path(TOOLKIT) / "hot3d")
    sys.path.insert(0, folder)

    def load(name: str) -> ModuleType:
        return importlib.import_module(f"data_loaders.{name}")

    yield load
    sys.path.remove(folder)


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("official") / "tree"
    synthesize_tree("hot3d", root, recordings=2, seed=4, n_events=2)
    return root


@pytest.fixture(scope="module")
def opened(tree) -> tuple[Path, hot3d.Hot3dReadings]:
    found = READER.find(tree)[0]
    return found.folder, read_readings(found)


def test_the_library_knows_every_object(official, tree, opened) -> None:
    library = official("loader_object_library").load_object_library(str(tree / "assets"))
    _, readings = opened
    assert library.object_uids >= {entry.object_id for entry in readings.objects}
    assert len(library.headset_uids) == 1


def test_objects_are_where_the_toolkit_says(official, opened) -> None:
    folder, readings = opened
    provider = official("ObjectPose3dProvider").load_object_pose_trajectory_from_csv(str(folder / hot3d.OBJECTS_FILE))
    for entry in readings.objects:
        for row in range(0, len(entry.rows.time_ns), 97):
            pose = provider[int(entry.rows.time_ns[row])].poses[entry.object_id].T_world_object.to_matrix()
            rotation = Rotation.from_quat(entry.rows.rotation[row], scalar_first=True).as_matrix()
            assert pose[:3, 3] == pytest.approx(entry.rows.position[row], abs=1e-12)
            assert pose[:3, :3] == pytest.approx(rotation, abs=1e-8)


def test_headset_and_masks_open(official, opened) -> None:
    folder, readings = opened
    poses, uid = official("HeadsetPose3dProvider").load_headset_pose_trajectory_from_csv(
        str(folder / hot3d.HEADSET_FILE)
    )
    assert list(poses) == readings.headset.time_ns.tolist()
    assert uid.isdecimal()
    for path in sorted((folder / hot3d.MASK_FOLDER).iterdir()):
        mask = official("loader_masks").load_mask_data(str(path))
        assert {str(stream) for stream in mask.stream_ids} == {hot3d.RGB_STREAM, *hot3d.SLAM_STREAMS}


def test_hands_are_posed_as_by_the_toolkit(official, opened) -> None:
    folder, readings = opened
    provider = official("UmeTrackHandDataProvider").UmeTrackHandDataProvider(
        str(folder / hot3d.UMETRACK_FILE), str(folder / hot3d.PROFILE_FILE)
    )
    poses = official("loader_hand_poses").load_hand_poses(str(folder / hot3d.UMETRACK_FILE))
    sides = official("loader_hand_poses").Handedness
    model = readings.hand_model
    assert model is not None
    for rows, side in zip(readings.hands, (sides.Left, sides.Right), strict=True):
        for row in range(0, len(rows.time_ns), 151):
            pose = poses[int(rows.time_ns[row])].poses[side]
            own = slice(row, row + 1)
            bones = umetrack.bone_transforms(model, rows.angles[own])
            placed = rows.position[own], rows.rotation[own]
            vertices = umetrack.pose_points(model.vertices, model.weights, bones, *placed, mirrored=side == sides.Right)
            # The toolkit works with float32 rest points.
            assert vertices[0] == pytest.approx(provider.get_hand_mesh_vertices(pose).numpy(), abs=1e-6)
