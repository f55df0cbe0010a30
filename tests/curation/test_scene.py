"""Which boxes of a recording stand still around its person, and how far the person comes into each."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from prbench.curation.curate import scene_boxes
from prbench.geometry.skeleton import Joint
from prbench.recording import ObjectTrack
from tests.curation.scenes import UPRIGHT, scene


def piece(object_id: str, centre, half, **changes) -> ObjectTrack:
    """Something that stands in its place."""
    still = ObjectTrack(
        object_id, f"piece {object_id}", "table", np.zeros(1), np.array([centre], dtype=float), UPRIGHT[None],
        np.ones(1, dtype=bool), -np.array(half, dtype=float), np.array(half, dtype=float), False,
    )  # fmt: skip
    return dataclasses.replace(still, **changes)


def test_only_what_stands_still_is_kept():
    recording = scene()
    moving = piece(
        "13",
        (0, 0, 5),
        (1, 1, 1),
        times=np.array([0.0, 9.0]),
        position=np.array([[0, 0, 5.0], [0, 0, 6.0]]),
        rotation=np.repeat(UPRIGHT[None], 2, axis=0),
        valid=np.ones(2, dtype=bool),
    )
    others = (
        piece("12", (0, 0.4, 3), (0.5, 0.4, 0.3)),
        moving,
        piece("14", (0, 1, 5), (1, 0, 1)),
        piece("15", (2, 1, 5), (1, 1, 0.02)),
    )
    recording = dataclasses.replace(recording, objects=(*recording.objects, *others), hinged_objects=frozenset({"15"}))
    assert [box.object_id for box in scene_boxes(recording)] == ["12"], "cup, mover, flat box and door are left out"


def test_a_box_tells_how_deep_the_person_came_into_it():
    recording = scene()
    pelvis = recording.body.joints[0, Joint.PELVIS]
    around = piece("12", pelvis, (0.08, 0.08, 0.08))
    apart = piece("13", pelvis + np.array([0.0, 0.0, 9.0]), (0.5, 0.5, 0.5))
    boxes = scene_boxes(dataclasses.replace(recording, furniture=(around, apart)))
    assert [box.entered for box in boxes] == [pytest.approx(0.08), 0.0]
    bodiless = dataclasses.replace(recording, body=None, furniture=(around,))
    assert scene_boxes(bodiless)[0].entered is None


def test_a_box_beside_its_own_origin_gets_its_middle():
    chest = piece("12", (1.0, 0.0, 2.0), (0.4, 0.3, 0.2), box_min=np.array([-0.4, 0.0, -0.2]))
    box = scene_boxes(dataclasses.replace(scene(), furniture=(chest,)))[0]
    assert box.centre == pytest.approx([1.0, 0.15, 2.0])
    assert box.half_extents == pytest.approx([0.4, 0.15, 0.2])
