"""The page: one file that needs no network, whose recording holds the very positions that were to be shown."""

from __future__ import annotations

import base64
import re

import numpy as np
import pytest

from prbench.viewing.replay.page import HOLD, camera_of, lane_offsets, viewer, with_overlay, write_page
from prbench.viewing.replay.scene import bone_segments
from tests.viewing.replay.scenes import a_scene

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "view.html"
    write_page([a_scene("static, none", n_frames=5), a_scene(n_frames=4)], path, lambda *_: None)
    return path.read_text(encoding="utf-8")


def _recording(page: str) -> tuple[dict, list[np.ndarray]]:
    """Messages and raw arrays of viser's recording: 8 bytes length, then zstd of (length, msgpack, arrays)."""
    import msgspec
    import zstandard

    packed = re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page)
    assert packed is not None
    raw = base64.b64decode(packed[1], validate=True)
    inner = zstandard.ZstdDecompressor().decompress(raw[8:], max_output_size=int.from_bytes(raw[:8], "little"))
    size = int.from_bytes(inner[:8], "little")
    recording = msgspec.msgpack.decode(inner[8 : 8 + size])
    arrays, at = [], 8 + size
    for length in recording["binaryBufferLengths"]:
        at += -at % 8
        arrays.append(np.frombuffer(inner[at : at + length], dtype=np.uint8))
        at += length
    return recording, arrays


def test_the_page_asks_for_nothing(page):
    markup = re.sub(r"<script\b.*?</script>", "", page, flags=re.DOTALL)
    assert not re.findall(r"""(?:src|href|action)\s*=\s*["']?(?!data:|#)[^"'\s>]""", markup.replace(' href="data:', ""))
    assert "url(http" not in page
    assert "@import" not in markup
    assert page.count("<script src") == 0
    assert len(page) < 3_000_000


def test_the_recording_lasts_as_long_as_the_sequences_and_their_holds(page):
    recording, _ = _recording(page)
    assert recording["durationSeconds"] == pytest.approx(9 / 20 + 2 * HOLD)
    times = [time for time, _ in recording["messages"]]
    assert times == sorted(times)


def test_the_last_pose_stands_in_the_recording(page):
    scene = a_scene("static, none", n_frames=5)
    bones = bone_segments(scene.motions[1].joints[-1] + lane_offsets(scene)[1])
    _, arrays = _recording(page)
    floats = [array.view(np.float32).reshape(-1, 2, 3) for array in arrays if array.size % 24 == 0]
    for bone in bones.astype(np.float32):
        assert any(np.isclose(array, bone, atol=1e-6).all(axis=(1, 2)).any() for array in floats)


def test_the_overlay_tells_scores_times_and_notices_and_trusts_no_name():
    scene = a_scene("<b>evil</b>, text", notice="Made up: for non-commercial purposes only")
    page = with_overlay("<html><title>Viser</title><body></body></html>", [scene, scene], hold=1.0)
    assert "&lt;b&gt;evil&lt;/b&gt;" in page
    assert "<b>evil" not in page
    assert "for non-commercial purposes only" in page
    assert "Prime Success yes" in page
    assert "(0.0 to 3.0 s, prime at 2.0 s)" in page
    assert "(4.0 to 7.1 s, prime at 6.0 s)" in page


def test_lanes_lie_beside_one_another_and_the_camera_sees_them():
    scene = a_scene("one", "two")
    lanes = lane_offsets(scene)
    assert lanes.sum(axis=0) == pytest.approx(np.zeros(3))
    assert (lanes @ scene.picture_axis) == pytest.approx(np.zeros(3))
    assert np.linalg.norm(np.diff(lanes, axis=0), axis=1).min() > 1.0
    place, look_at = camera_of(scene)
    assert place[1] > 1.0
    assert np.linalg.norm(place - look_at) > 2.0


def test_viser_announces_no_server_on_the_terminal(capfd) -> None:
    with viewer():
        pass
    assert capfd.readouterr().out == ""
