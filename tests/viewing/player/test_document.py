"""What the player is told of a sequence: the numbers of the scene, to the millimetre, and the metrics' own spans."""

from __future__ import annotations

import base64
import dataclasses
import json

import numpy as np
import pytest

from prbench.metrics import GazeRays
from prbench.viewing.player.document import encoded, player_sequence, spans, within
from prbench.viewing.replay.scene import RECORDED, ShownMotion
from tests.viewing.replay.scenes import a_scene, walking


def told(scene) -> dict:
    return json.loads(encoded(player_sequence(scene)))


def array(text: str, kind: str = "<i2") -> np.ndarray:
    return np.frombuffer(base64.b64decode(text, validate=True), dtype=kind)


def test_joints_are_those_of_the_scene_to_half_a_millimetre():
    scene = a_scene("static, none")
    for motion, shown in zip(told(scene)["motions"], scene.motions, strict=True):
        joints = array(motion["joints"]).reshape(-1, 22, 3) / 1000
        np.testing.assert_allclose(joints, shown.joints, atol=0.00051)
        assert np.linalg.norm(array(motion["head_ray"]).reshape(-1, 3), axis=1) == pytest.approx(10_000, abs=1)
        assert len(motion["joints"]) <= 60_000


def test_times_goal_and_limits_are_those_of_the_protocol():
    document = told(a_scene())
    assert (document["version"], document["n_frames"], document["prime_time"]) == (1, 61, 2.0)
    assert document["event_time"] == pytest.approx(3.0)
    assert document["goal"]["location"] == [0.1, 1.0, 2.0]
    assert np.mean(document["goal"]["box"], axis=0) == pytest.approx([0.1, 1.0, 2.0])
    # A second before and after the prime time, but for the frames in which a stay of 0.1 s could not end.
    assert document["limits"] == {"prime_distance": 0.25, "reach_distance": 0.1, "window": [20, 58]}


def test_what_is_not_known_is_null():
    document = told(a_scene("one", recorded=False))
    (motion,) = document["motions"]
    assert document["goal"] is document["mesh"] is motion["wrist"] is motion["head"] is motion["gaze"] is None
    assert (motion["on_target"], motion["within_reach"], motion["kind"]) == ([], [], "method")


def test_gaze_keeps_its_gaps_and_no_nan():
    scene = a_scene(with_eyes=True)
    gaze = scene.motions[0].gaze
    assert gaze is not None
    broken = GazeRays(np.where(gaze.valid[:, None], gaze.origin, np.nan), gaze.direction, gaze.valid)
    motion = dataclasses.replace(scene.motions[0], gaze=broken)
    (shown,) = told(dataclasses.replace(scene, motions=(motion,)))["motions"]
    assert array(shown["gaze_valid"], "u1").tolist() == gaze.valid.astype(int).tolist()
    rays = array(shown["gaze"]).reshape(-1, 6)
    np.testing.assert_allclose(rays[4, :3] / 1000, gaze.origin[4], atol=0.00051)
    assert rays[4, 3:].tolist() == [0, 0, 10_000]


def test_spans_are_the_frames_that_the_metrics_count():
    standing = np.repeat(walking()[:1], 61, axis=0)
    moved = standing.copy()
    moved[20:41, :, 2] += np.linspace(0.0, 2.0, 21)[:, None]  # two metres a second, feet on the floor
    moved[41:, :, 2] += 2.0
    scene = a_scene()
    motion = ShownMotion(RECORDED, "#303030", moved)
    (shown,) = told(dataclasses.replace(scene, motions=(motion,)))["motions"]
    assert shown["sliding"] == [[20, 39]]
    distance = array(shown["wrist"]) / 1000
    near = [span for first, last in shown["within_reach"] for span in range(first, last + 1)]
    assert near == np.flatnonzero(distance <= 0.1).tolist()
    on_target = [frame for first, last in shown["on_target"] for frame in range(first, last + 1)]
    assert on_target == np.flatnonzero(array(shown["head"]) <= 250).tolist() != []


def test_scores_are_told_in_the_words_of_the_pictures():
    scene = a_scene("static, none")
    scores = {**scene.motions[1].scores, "plausible": 0.0, "foot_skating": 0.4}
    motion = dataclasses.replace(scene.motions[1], scores=scores)
    (shown,) = told(dataclasses.replace(scene, motions=(motion,)))["motions"]
    found = {score["title"]: (score["text"], score["good"]) for score in shown["scores"]}
    assert found["Prime Success"] == ("yes", True)
    assert found["Reach Success"] == ("no", False)
    assert found["Location Error"] == ("yes", False)
    assert found["Plausible"] == ("no", False)
    assert found["Foot Skating"] == ("40 % of steps", None)


def test_a_name_ends_no_script():
    scene = dataclasses.replace(a_scene("</script><b>"), title="</script>")
    assert b"<" not in encoded(player_sequence(scene))
    assert told(scene)["title"] == "</script>"


@pytest.mark.parametrize(
    ("mask", "found"),
    [([], []), ([0, 0], []), ([1, 1], [[0, 1]]), ([0, 1, 1, 0, 1], [[1, 2], [4, 4]])],
)
def test_a_span_names_its_first_and_last_frame(mask, found):
    assert spans(np.array(mask, dtype=bool)) == found


def test_a_page_holds_the_first_sequences_that_fit():
    sequence = player_sequence(a_scene("one"))
    size = len(encoded(sequence))
    assert len(within([sequence] * 5, 3 * size)) == 3
    assert len(within([sequence] * 5, 10)) == 1  # never none
