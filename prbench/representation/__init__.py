"""22 joints to the 263 features of HumanML3D and back (docs/specification/humanml3d.md).

This is the NumPy side, which checks what it is given; the differentiable decoding in
torch is :mod:`prbench.representation.tensors`.
"""

from __future__ import annotations

from prbench.representation.encoding import (
    UniformSkeleton,
    canonicalise,
    check_joints,
    decode,
    encode,
    mirror,
    rest_offsets,
    retarget,
    root_scale,
)
from prbench.representation.features import BLOCKS, N_FEATURES, REST_OFFSETS, Mode, Statistics, StatisticsAccumulator
