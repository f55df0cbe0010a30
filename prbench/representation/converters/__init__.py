"""Converters from what models put out to the 22 joints in the canonical frame (``docs/wrapping.md``).

Three sources: HumanML3D features, SMPL parameters, joints of another skeleton. Every step is a small pure function in
NumPy; nothing here imports torch.
"""

from __future__ import annotations

from prbench.representation.converters.features import (
    check_features,
    feature_rows,
    joints_from_features,
    motions_from_features,
    read_feature_statistics,
    relative_root,
)
from prbench.representation.converters.named_skeletons import JOINT_MAPS, JointMap, joint_map, joint_map_by_names
from prbench.representation.converters.placement import (
    at_rate,
    at_times,
    check_limbs,
    check_sides,
    frames_needed,
    front_of_legs,
    in_frame_of,
    on_body_of,
    on_floor,
    padded,
    placed_on,
    to_canonical,
    to_y_up,
)
from prbench.representation.converters.smpl import (
    RestJoints,
    RotationForm,
    SmplParameters,
    quaternions_of,
    read_amass,
    read_rest_joints,
    smpl_joints,
)

__all__ = [
    "JOINT_MAPS",
    "JointMap",
    "RestJoints",
    "RotationForm",
    "SmplParameters",
    "at_rate",
    "at_times",
    "check_features",
    "check_limbs",
    "check_sides",
    "feature_rows",
    "frames_needed",
    "front_of_legs",
    "in_frame_of",
    "joint_map",
    "joint_map_by_names",
    "joints_from_features",
    "motions_from_features",
    "on_body_of",
    "on_floor",
    "padded",
    "placed_on",
    "quaternions_of",
    "read_amass",
    "read_feature_statistics",
    "read_rest_joints",
    "relative_root",
    "smpl_joints",
    "to_canonical",
    "to_y_up",
]
