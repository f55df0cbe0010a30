"""22 joints to the 263 features of HumanML3D and back (docs/specification/humanml3d.md).

This is the NumPy side, which checks what it is given; the differentiable torch side is
:mod:`prbench.representation.tensors`.
"""

from __future__ import annotations

from prbench.representation.clips import at_20_fps, canonicalise, check_joints, every_stride, mirror
from prbench.representation.encoding import decode, decode_rotations, encode
from prbench.representation.features import BLOCKS, N_FEATURES, REST_OFFSETS, Mode
from prbench.representation.statistics import Statistics, StatisticsAccumulator
from prbench.representation.uniform_skeleton import UniformSkeleton, rest_offsets, retarget, root_scale

__all__ = [
    "BLOCKS",
    "N_FEATURES",
    "REST_OFFSETS",
    "Mode",
    "Statistics",
    "StatisticsAccumulator",
    "UniformSkeleton",
    "at_20_fps",
    "canonicalise",
    "check_joints",
    "decode",
    "decode_rotations",
    "encode",
    "every_stride",
    "mirror",
    "rest_offsets",
    "retarget",
    "root_scale",
]
