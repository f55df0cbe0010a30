"""Scene penetration: how often and how deep a body comes into the boxes of what stands around it.

Definition: docs/specification/scene.md#scene-penetration. Which boxes are solid is decided by whoever hands them in
(:func:`prbench.harness.conditions.solid_boxes`); a box that holds the goal is left out here, because whatever is
reached in a cupboard lies in the cupboard's box.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from prbench.geometry.shapes import deepest
from prbench.metrics.batch import MotionBatch, ScoringPair, ScoringTargets
from prbench.metrics.registry import MetricFamily, MetricValues, detail
from prbench.protocol.manifests import MetricConstants, load_scene_constants

Numbers = Float[np.ndarray, " n"]


def scene_penetration(motion: MotionBatch, targets: ScoringTargets, *, depth: float) -> tuple[Numbers, Numbers]:
    """Share of the frames in which a joint lies deeper than ``depth`` in a box, and the largest depth of any joint.

    Args:
        motion: Canonical frame, metres.
        targets: Goals and the boxes of the scene.
        depth: Metres inside a box from which a joint penetrates it.

    Returns:
        The shares, 0 to 1; and the largest depths, metres, 0 where no joint is in a box.

    Raises:
        ValueError: if the targets hold no boxes.
    """
    if targets.scene is None:
        raise ValueError("the targets hold no boxes of the scene")
    share = np.zeros(motion.n_sequences)
    largest = np.zeros(motion.n_sequences)
    for row in range(motion.n_sequences):
        joints = motion.values[motion.offsets[row] : motion.offsets[row + 1]].astype(np.float64)
        boxes = targets.scene.part(row, row + 1)
        # A box in which the goal lies is open.
        in_frame = deepest(joints, boxes.chosen(boxes.depth(targets.goal_location[row][None])[0] <= 0))
        share[row] = (in_frame > depth).mean()
        largest[row] = in_frame.max()
    return share, largest


def _compute(pair: ScoringPair, constants: MetricConstants) -> tuple[MetricValues, MetricValues]:  # noqa: ARG001
    assert pair.targets.scene is not None
    share, largest = scene_penetration(pair.predicted, pair.targets, depth=load_scene_constants()["depth"])
    flags = {"no_boxes": np.diff(pair.targets.scene.offsets) == 0}
    return MetricValues("scene_penetration", share, flags), MetricValues("scene_depth", largest, flags)


_METRICS = (
    detail("scene_penetration", "Scene penetration", "ratio", 41, higher_is_better=False),
    detail("scene_depth", "Scene penetration (depth)", "m", 42, higher_is_better=False),
)
FAMILY = MetricFamily(_METRICS, _compute, needs_scene=True)
