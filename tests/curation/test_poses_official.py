"""The official reader, with which EgoAllo reads its inputs, on what is prepared for it."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.curation.poses.states import prepare
from prbench.readers.adt import READER, find_recordings
from prbench.readers.adt.format import Z_UP_FROM_SCENE
from prbench.readers.adt.synthetic import write
from prbench.synthetic.layouts import layout_for
from prbench.synthetic.people import perform

official = pytest.importorskip(
    "projectaria_tools.core.mps",
    reason="the official reader is not installed: pip install 'prbench[official-readers]'",
)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """The trajectory in a prepared folder, its frames, and the recording it was made from."""
    root = tmp_path_factory.mktemp("adt")
    write(layout_for("adt").sense(perform("adt", seed=11, index=3, n_events=1, provocations={})), root / "seq")
    (found,) = find_recordings(root)
    trajectory, frames = prepare(READER.egoallo_inputs(root, found), root / "prepared")
    return trajectory, frames, root / "seq"


def test_the_official_reader_sees_the_same_path_with_z_up(folders):
    trajectory, _, recording = folders
    turned = official.read_closed_loop_trajectory(str(trajectory))
    native = official.read_closed_loop_trajectory(str(recording / "aria_trajectory.csv"))
    np.testing.assert_allclose(turned[0].gravity_world, [0, 0, -9.81], atol=1e-9)
    by_time = {pose.tracking_timestamp: pose.transform_world_device.to_matrix() for pose in turned}
    shared = [pose for pose in native if pose.tracking_timestamp in by_time and pose.quality_score > 0]
    assert len(shared) > len(native) // 4
    for pose in shared:
        expected = Z_UP_FROM_SCENE @ pose.transform_world_device.to_matrix()
        np.testing.assert_allclose(by_time[pose.tracking_timestamp], expected, atol=1e-6)


def test_the_number_of_frames_is_that_of_egoallos_own_sampling(folders):
    trajectory, frames, _ = folders
    poses = official.read_closed_loop_trajectory(str(trajectory))
    first, last = (poses[end].tracking_timestamp.total_seconds() for end in (0, -1))
    step = int(len(poses) / (last - first) // 30)
    assert step == 33
    assert frames == len(range(0, len(poses), step)) - 1


def test_the_invented_floor_passes_the_strictest_filter(folders):
    trajectory, _, _ = folders
    points = official.read_global_point_cloud(str(trajectory.with_name("semidense_points.csv.gz")))
    assert len(points) > 1000
    assert {point.position_world[2] for point in points} == {0.0}
    assert max(point.inverse_distance_std for point in points) < 0.0001
    assert max(point.distance_std for point in points) < 0.005
