"""The 51 joints and 57 markers of the optical suit, from 22 joints and finger bases.

Source: docs/specification/adt.md#joints.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int

from prbench.readers.adt import format as adt
from prbench.skeleton import Joint

_DIRECT = {
    "Skeleton": Joint.PELVIS, "Ab": Joint.SPINE1, "Chest": Joint.SPINE3, "Neck": Joint.NECK, "Head": Joint.HEAD,
    "LShoulder": Joint.LEFT_COLLAR, "LUArm": Joint.LEFT_SHOULDER, "LFArm": Joint.LEFT_ELBOW, "LHand": Joint.LEFT_WRIST,
    "RShoulder": Joint.RIGHT_COLLAR, "RUArm": Joint.RIGHT_SHOULDER, "RFArm": Joint.RIGHT_ELBOW,
    "RHand": Joint.RIGHT_WRIST,
    "LThigh": Joint.LEFT_HIP, "LShin": Joint.LEFT_KNEE, "LFoot": Joint.LEFT_ANKLE, "LToe": Joint.LEFT_FOOT,
    "RThigh": Joint.RIGHT_HIP, "RShin": Joint.RIGHT_KNEE, "RFoot": Joint.RIGHT_ANKLE, "RToe": Joint.RIGHT_FOOT,
}  # fmt: skip

# Straight fingers: base beside the middle-finger base (towards the thumb), and the two further joints along the hand.
_FINGERS = {
    "Thumb": (0.035, (-0.055, -0.030, -0.005)),
    "Index": (0.022, (0.0, 0.042, 0.066)),
    "Middle": (0.0, (0.0, 0.045, 0.072)),
    "Ring": (-0.020, (0.0, 0.042, 0.067)),
    "Pinky": (-0.038, (-0.006, 0.028, 0.047)),
}

_MARKED_BONES = (
    ("Skeleton", "Ab"), ("Ab", "Chest"), ("Chest", "Neck"), ("Neck", "Head"),
    ("LShoulder", "LUArm"), ("LUArm", "LFArm"), ("LFArm", "LHand"), ("LHand", "LMiddle1"),
    ("RShoulder", "RUArm"), ("RUArm", "RFArm"), ("RFArm", "RHand"), ("RHand", "RMiddle1"),
    ("Skeleton", "LThigh"), ("LThigh", "LShin"), ("LShin", "LFoot"), ("LFoot", "LToe"),
    ("Skeleton", "RThigh"), ("RThigh", "RShin"), ("RShin", "RFoot"),
)  # fmt: skip
_MARKERS_ALONG_BONE = (0.2, 0.5, 0.8)


def suit_joints(
    joints: Float[np.ndarray, "n 22 3"], finger_bases: Float[np.ndarray, "n 2 3"]
) -> Float[np.ndarray, "n 51 3"]:
    """Return the 51 native joints: 21 of the body as they are, and straight fingers.

    Args:
        joints: The 22 joints, metres; spine2 has no native joint, the reader takes it between spine1 and spine3.
        finger_bases: Middle-finger bases, left and right.
    """
    native = np.zeros((len(joints), adt.N_NATIVE_JOINTS, 3))
    for name, joint in _DIRECT.items():
        native[:, adt.JOINT_NAMES.index(name)] = joints[:, joint]
    for side, letter in enumerate("LR"):
        elbow, wrist = (joints[:, joint + side] for joint in (Joint.LEFT_ELBOW, Joint.LEFT_WRIST))
        shoulder = joints[:, Joint.LEFT_SHOULDER + side]
        base = finger_bases[:, side]
        along = _unit(base - wrist)
        # The normal of the arm's plane is the palm's side axis; a straight arm has none, any steady one will do.
        plane = np.cross(wrist - elbow, elbow - shoulder)
        aside = _unit(np.cross(np.where(_length(plane) > 1e-4, plane, (0.0, 1.0, 0.0)), along))
        for finger, (beside, places) in _FINGERS.items():
            for number, place in enumerate(places, start=1):
                index = adt.JOINT_NAMES.index(f"{letter}{finger}{number}")
                native[:, index] = base + beside * aside + place * along
    return native


def suit_markers(joints: Float[np.ndarray, "n 51 3"]) -> Float[np.ndarray, "n 57 3"]:
    """Return synthetic markers: three along each of 19 bones."""
    first, second = (np.array([adt.JOINT_NAMES.index(bone[end]) for bone in _MARKED_BONES]) for end in (0, 1))
    share = np.array(_MARKERS_ALONG_BONE)[:, None]
    points = joints[:, first, None] * (1 - share) + joints[:, second, None] * share
    return points.reshape(len(joints), adt.N_MARKERS, 3)


def suit_segments() -> Int[np.ndarray, "51"]:
    """Return which joints the suit shifts together: a hand with its fingers, every other joint alone."""
    hands = {"L": adt.JOINT_NAMES.index("LHand"), "R": adt.JOINT_NAMES.index("RHand")}
    is_finger = [name[1:-1] in _FINGERS for name in adt.JOINT_NAMES]
    owner = [hands[n[0]] if finger else i for i, (n, finger) in enumerate(zip(adt.JOINT_NAMES, is_finger, strict=True))]
    return np.unique(owner, return_inverse=True)[1]


def _length(vectors: np.ndarray) -> np.ndarray:
    return np.linalg.norm(vectors, axis=-1, keepdims=True)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(_length(vectors), 1e-12)
