"""Narrated spans as clips: placed exactly, never bridged, and every text accounted for."""

from __future__ import annotations

import numpy as np
import pytest

from prbench.geometry.skeleton import Joint, transform_points
from prbench_adapters.corpora.nymeria.clock import ClockOffset
from prbench_adapters.corpora.nymeria.format import Narration
from prbench_adapters.corpora.nymeria.source import recording_clips
from prbench_adapters.corpora.nymeria.suit import CleanSuit, Piece
from prbench_adapters.corpora.sources import ClipLimits, RecordingIdentity, cut_clip
from tests.fakes import STANDING, smooth_motion

BELONGING = RecordingIdentity("nymeria", "seq", "p", "train", "p")
LIMITS = ClipLimits(20.0, 20, 241)


def piece(start: float, seconds: float, name: str = "a") -> Piece:
    return Piece(start, smooth_motion(name, int(seconds * 240) + 1).astype(np.float64))


def row(start: float, end: float, text: str = "C waves.", *, annotator: str = "", kind: str = "atomic_action"):
    return Narration(kind, start, end, (("atomic actions", text),), annotator)


def build(rows, *pieces, offset: float | None = 0.0, limits: ClipLimits = LIMITS):
    body = CleanSuit(pieces or (piece(100.0, 20.0),), "suit", 20.0, (), np.zeros((0, 4)))
    clock = None if offset is None else ClockOffset("file", offset)
    read = recording_clips(BELONGING, body, rows, clock, limits)
    return read.clips, read.annotations


def outcome(rows, *pieces, **more) -> str:
    _, annotations = build(rows, *pieces, **more)
    assert len(annotations) == len(rows)
    return annotations[0].outcome


def test_a_span_of_five_seconds_has_100_frames_at_20_and_150_at_30_per_second():
    (clip,), _ = build([row(2.0, 7.0)], offset=100.0)
    assert clip.n_frames == len(clip.joints) == 100
    assert (clip.start_time, clip.end_time, clip.cut) == (pytest.approx(102.0), pytest.approx(107.0), False)
    (faster,), _ = build([row(2.0, 7.0)], offset=100.0, limits=ClipLimits(30.0, 30, 361))
    assert faster.n_frames == 150


def test_frames_are_those_of_the_motion_at_their_times():
    motion = piece(100.0, 20.0)
    (clip,), _ = build([row(3.001, 6.0)], motion, offset=100.0)
    first = int(np.ceil(3.001 * 240))
    world = transform_points(clip.world_from_canonical, clip.joints)
    np.testing.assert_allclose(world, motion.joints[first : first + 12 * clip.n_frames : 12], atol=1e-9)
    before = transform_points(clip.world_from_canonical, clip.previous_joints)
    np.testing.assert_allclose(before, motion.joints[first - 12], atol=1e-9)
    after = transform_points(clip.world_from_canonical, clip.next_joints)
    np.testing.assert_allclose(after, motion.joints[first + 12 * clip.n_frames], atol=1e-9)
    assert (clip.previous_source, clip.next_source) == ("recorded", "recorded")


def test_the_first_pose_stands_over_the_origin_and_faces_z():
    (clip,), _ = build([row(2.0, 7.0)], offset=100.0)
    np.testing.assert_allclose(clip.joints[0, Joint.PELVIS, [0, 2]], 0.0, atol=1e-9)
    assert clip.joints[..., 1].min() == pytest.approx(0.0, abs=1e-9)
    across = clip.joints[0, Joint.LEFT_HIP] - clip.joints[0, Joint.RIGHT_HIP]
    across += clip.joints[0, Joint.LEFT_SHOULDER] - clip.joints[0, Joint.RIGHT_SHOULDER]
    assert across[0] > 0.0
    assert across[2] == pytest.approx(0.0, abs=1e-9)


def test_neighbours_outside_of_the_motion_continue_its_speed():
    motion = np.repeat(STANDING[None], 10, axis=0) + 0.1 * np.arange(10)[:, None, None] * [0.0, 0.0, 1.0]
    columns = {
        "kind": "k", "captions": (), "text_start": 0.0, "text_end": 0.0, "cut": False, "mirrored": False,
        "clock_method": "same", "clock_offset": 0.0, "clock_quality": None, "approximate": False,
        "pose_source": "x", "head_tilt_deg": 0.0,
    }  # fmt: skip
    cut = cut_clip(motion, 0, 1, 10, fps=20.0, start=0.0, sequence_id="s", **vars(BELONGING), **columns)
    assert cut is not None
    np.testing.assert_allclose(cut.previous_joints, cut.joints[0] - [0.0, 0.0, 0.1], atol=1e-12)
    np.testing.assert_allclose(cut.next_joints, cut.joints[-1] + [0.0, 0.0, 0.1], atol=1e-12)
    assert (cut.previous_source, cut.next_source) == ("extrapolated", "extrapolated")


def test_long_spans_are_cut_and_say_so():
    (clip,), _ = build([row(0.0, 16.0)], offset=100.0)
    assert clip.n_frames == 241
    assert clip.cut
    assert clip.text_end == 16.0


def test_every_reason_to_leave_a_text_out():
    assert outcome([row(4.0, 3.0)], offset=100.0) == "end_before_start"
    assert outcome([row(4.0, 4.9)], offset=100.0) == "too_short"
    assert outcome([row(4.0, 5.0)], offset=100.0) == "clip"
    assert outcome([row(4.0, 7.0, "")], offset=100.0) == "no_text"
    assert outcome([row(25.0, 29.0)], offset=100.0) == "outside_motion"
    assert outcome([row(18.0, 22.0)], offset=100.0) == "outside_motion"
    assert outcome([row(4.0, 7.0)], offset=None) == "no_clock"


def test_a_span_that_crosses_a_jump_is_never_bridged():
    pieces = piece(100.0, 10.0), piece(110.5, 10.0, "b")
    assert outcome([row(8.0, 12.5)], *pieces, offset=100.0) == "clock_gap"
    clips, _ = build([row(6.4, 10.4)], *pieces, offset=100.0)  # nine tenths lie before the jump
    assert clips[0].end_time < 110.06
    clips, _ = build([row(12.0, 16.0)], *pieces, offset=100.0)
    assert clips[0].start_time == pytest.approx(112.0)


def test_a_span_that_begins_before_the_suit_is_trimmed_where_most_of_it_is_there():
    (clip,), _ = build([row(-0.5, 4.5)], offset=100.0)
    assert (clip.start_time, clip.n_frames) == (pytest.approx(100.0), 90)


def test_texts_of_one_span_share_a_clip_whatever_their_order_in_the_file():
    rows = [
        row(2.0, 6.0, "C sits.", annotator="b"),
        row(7.0, 10.0),
        row(2.0, 6.0, "C sits down.", annotator="a"),
        row(2.0, 6.0, "C sits."),
    ]
    clips, annotations = build(rows, offset=100.0)
    again, same = build(rows[::-1], offset=100.0)
    assert annotations == same
    assert [clip.sequence_id for clip in clips] == [clip.sequence_id for clip in again]
    assert [caption.text for caption in clips[0].captions] == ["C sits.", "C sits down."]
    assert clips[0].extra == {"annotators": "a b"}
    assert sorted(annotation.outcome for annotation in annotations) == ["clip", "clip", "clip", "duplicate"]


def test_answers_become_captions_of_their_kind():
    texts = (("body posture", "C stands."), ("focus attention", ""))
    (clip,), annotations = build([Narration("motion_narration", 2.0, 6.0, texts)], offset=100.0)
    assert [(caption.kind, caption.text) for caption in clip.captions] == [("body posture", "C stands.")]
    assert [annotation.outcome for annotation in annotations] == ["clip", "no_text"]


def test_ids_are_made_of_native_keys():
    (clip,), _ = build([row(2.0, 7.0)], offset=100.0)
    assert clip.sequence_id == "nymeria/seq/atomic_action/2000000-7000000/suit"
