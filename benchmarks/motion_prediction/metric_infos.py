"""What tables, intervals and boards need to know of the scores of motion prediction.

Source: docs/specification/motion-prediction.md#metrics.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

from prbench.metrics import MetricInfo
from prbench_benchmarks.motion_prediction.joint_sets import JOINT_SETS
from prbench_benchmarks.motion_prediction.protocol import load_prediction_protocol

_LOWER = False
_HIGHER = True


@cache
def prediction_metrics() -> tuple[MetricInfo, ...]:
    """Return all scores that ``scoring.score_batch`` may give, in printed order."""
    rules = load_prediction_protocol().evaluation
    infos = [
        _info("ade", "ADE", main=True),
        _info("fde", "FDE", main=True),
        _info("mmade", "MMADE", main=True),
        _info("mmfde", "MMFDE", main=True),
        # Spread is a merit beside a small error alone: a predictor that answers anything has most of it.
        _info("apd", "APD", main=True, better=_HIGHER, ranked=False, compared=False),
        # Of windows that end at the event alone: where no window of a table does, boards have an empty column.
        _info("wrist_to_goal", "Wrist to goal", main=True),
        _info("ade_mean", "ADE, mean over samples"),
        _info("fde_mean", "FDE, mean over samples"),
        _info("mmade_canonical", "MMADE, own frames"),
        _info("mmfde_canonical", "MMFDE, own frames"),
        _info("similar_pasts", "Similar pasts", unit="windows", better=None),
        _info("similar_pasts_canonical", "Similar pasts, own frames", unit="windows", better=None),
    ]
    for n in rules.samples:
        infos += [_info(f"ade@k{n}", f"ADE, K = {n}"), _info(f"fde@k{n}", f"FDE, K = {n}")]
    for seconds in rules.horizons:
        infos.append(_info(f"ade@{seconds:g}s", f"ADE to {seconds:g} s"))
        infos.append(_info(f"fde@{seconds:g}s", f"FDE at {seconds:g} s"))
    infos += [
        _info("wrists_ade", "ADE, wrists"),
        _info("wrists_fde", "FDE, wrists"),
        _info("first_frame_jump", "First-frame jump"),
        _info("bone_error_percent", "Bone error", unit="%"),
        _info("wrist_to_goal_mean", "Wrist to goal, mean over samples"),
        _info("wrist_to_goal_recorded", "Wrist to goal, as recorded", better=None),
        _info("pelvis_at_event", "Pelvis at event"),
        _info("pelvis_at_event_mean", "Pelvis at event, mean over samples"),
        _info("mpjpe", "MPJPE"),
    ]
    joints = dict.fromkeys(name for each in JOINT_SETS.values() for name in each.names)
    infos += [_info(f"joint/{name}", f"MPJPE, {name}", is_detail=True) for name in joints]
    return tuple(replace(info, position=position) for position, info in enumerate(infos))


def _info(id: str, title: str, *, unit: str = "m", better: bool | None = _LOWER, **more: bool) -> MetricInfo:
    """Return a score that compares with what happened; its position is set with those of all others."""
    more = {"main": False, **more}
    return MetricInfo(
        id=id, title=title, unit=unit, higher_is_better=better, position=0, compares_with_recorded=True, **more
    )
