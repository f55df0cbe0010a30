"""Checks that features were restored with the statistics of their own model, judged over all motions of a batch."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from prbench.errors import InputFileError
from prbench.representation.encoding import decode
from prbench.representation.features import FOOT_CONTACTS, JOINT_VELOCITIES, ROOT_LINEAR_VELOCITY

FEATURES = "features"
"""Name in messages of an array that comes from no file and no named method."""

_WALKS = 0.005  # metres a frame; slower pelvises say nothing about their scale
_SAME_SCALE = 3.0  # factor between the two ways in which the step of the pelvis is written
_NO_MODEL = 10.0  # the same, enough for one motion alone; random weights seldom come here (2 of 72 did)
_FARTHEST_CONTACT = 4.0
_LEAST_CONTACTS_VARY = 0.1  # an evaluator's statistics leave 0.04 of the change between 0 and 1 …
_UNDECIDED = 0.05  # … and neither of them, but their mean
_FASTEST = 0.15  # metres a frame, mean over joints and frames: 3 m/s
_ENOUGH = 4  # motions whose majority is believed; of fewer each needs a second sign

_OTHER_STATISTICS = (
    "The features were never restored, or with the statistics of another model: take the Mean.npy and Std.npy that this"
    " one was trained with (those of text-to-motion evaluators have root and contacts about 25 times smaller). If the"
    " first three columns are absolute, say root='absolute'. If the model itself makes such features (it is hardly"
    " trained, or has random weights), say check=False."
)

_warned: set[str] = set()
"""Sources that a warning was given for; a run of thousands of motions needs one."""


class FeatureWarning(UserWarning):
    """Single motions of a model look as if they had been restored with the statistics of another one."""


@dataclass(frozen=True)
class _Doubt:
    """Doubt about one motion."""

    row: int
    where: str
    expected: str
    found: str
    sure: bool
    """Nothing but other statistics explains it, so that the motion needs no company to be refused."""


def check_features(
    features: Float[np.ndarray, "rows 263"] | Sequence[Float[np.ndarray, "_ 263"]],
    *,
    source: str = FEATURES,
    sequences: Sequence[str] | np.ndarray | None = None,
) -> None:
    """Refuse features that were not restored, or with the statistics of another model.

    The step of the pelvis stands in a row twice, in the root block and among the joint velocities. Statistics of an
    evaluator scale the one about 25 times as small as those of a generator, and leave the other. Numbers that were
    never restored are near 1 and move joints by half a metre a frame. Wrong statistics show in most motions, a model
    that has learnt little in some; so it counts what most of the motions say, and single ones lead to one
    :class:`FeatureWarning` for each source.

    Args:
        features: Of one motion or several: raw, relative root.
        source: Name of the method, with which messages begin.
        sequences: Name of each motion (``batch.opaque_id``), for messages.

    Raises:
        InputFileError: if in more than half of the motions that walk the two differ by more than a factor of three, if
            in more than half the foot contacts, which are 0 or 1, lie nowhere near, or joints move by more than 3 m/s
            in the mean. Fewer than four motions are refused for their steps only if the factor is above ten, or the
            contacts are odd, too.
    """
    motions = [features] if isinstance(features, np.ndarray) and features.ndim == 2 else list(features)
    walking = [row for row, motion in enumerate(motions) if max(_step_lengths(motion)) > _WALKS]
    everything = list(range(len(motions)))
    examinations: tuple[tuple[Callable[[int, np.ndarray], _Doubt | None], list[int]], ...] = (
        (_steps, walking),
        (_contacts, everything),
        (_speed, everything),
    )
    for look, rows in examinations:
        doubts = [doubt for row in rows if (doubt := look(row, motions[row])) is not None]
        if not doubts:
            continue
        believed = len(rows) >= _ENOUGH or all(doubt.sure for doubt in doubts)
        if 2 * len(doubts) > len(rows) and believed:
            many = f", and likewise in {len(doubts)} of {len(rows)} motions" if len(rows) > 1 else ""
            first = doubts[0]
            raise InputFileError(
                source,
                _place(first, sequences, len(motions)),
                expected=first.expected,
                found=first.found + many,
                remedy=_OTHER_STATISTICS,
            )
        _warn(doubts, len(rows), source, sequences, len(motions))


def _warn(
    doubts: list[_Doubt], judged: int, source: str, sequences: Sequence[str] | np.ndarray | None, motions: int
) -> None:
    """Tell the first doubt, once for each source."""
    if source in _warned:
        return
    _warned.add(source)
    first = doubts[0]
    warnings.warn(
        f"{source}, {_place(first, sequences, motions)}: expected {first.expected}, found {first.found}"
        f" (odd in {len(doubts)} of the {judged} motions that show it). They are kept, and this is told once. A model"
        " that has learnt little makes such motions; if most of them are odd, the Mean.npy and Std.npy are not those"
        " that it was trained with.",
        FeatureWarning,
        stacklevel=4,
    )


def _place(doubt: _Doubt, sequences: Sequence[str] | np.ndarray | None, motions: int) -> str:
    """Row and name of the motion, and its columns."""
    parts = [f"row {doubt.row}"] if motions > 1 or sequences is not None else []
    if sequences is not None:
        parts[0] += f" (sequence {sequences[doubt.row]})"
    return ", ".join([*parts, doubt.where])


def _steps(row: int, motion: np.ndarray) -> _Doubt | None:
    """The pelvis steps by another length in the root block than among the joint velocities."""
    stepped, walked = _step_lengths(motion)
    ratio = stepped / max(walked, 1e-12)
    if 1 / _SAME_SCALE < ratio < _SAME_SCALE:
        return None
    contacts = motion[:, FOOT_CONTACTS]
    undecided = np.minimum(np.abs(contacts), np.abs(contacts - 1)).min() > _UNDECIDED
    squeezed = bool(undecided) and float(np.ptp(contacts, axis=0).max()) < _LEAST_CONTACTS_VARY
    stretched = float(np.abs(contacts).max()) > _FARTHEST_CONTACT
    return _Doubt(
        row,
        "columns 1 and 2",
        expected=f"steps of the pelvis as long as those in columns 193 and 195 ({walked * 1000:.1f} mm a frame)",
        found=f"{stepped * 1000:.1f} mm ({ratio:.2g} times as long)",
        sure=squeezed or stretched or not 1 / _NO_MODEL < ratio < _NO_MODEL,
    )


def _step_lengths(motion: np.ndarray) -> tuple[float, float]:
    """Mean step of the pelvis on the ground, metres: from the root block, and from the joint velocities."""
    pelvis = motion[:, JOINT_VELOCITIES.start : JOINT_VELOCITIES.start + 3 : 2]
    stepped = float(np.linalg.norm(motion[:, ROOT_LINEAR_VELOCITY], axis=1).mean())
    walked = float(np.linalg.norm(pelvis, axis=1).mean())
    return stepped, walked


def _contacts(row: int, motion: np.ndarray) -> _Doubt | None:
    """Foot contacts, which are 0 or 1, lie nowhere near."""
    contacts = motion[:, FOOT_CONTACTS]
    if np.abs(contacts).max() <= _FARTHEST_CONTACT:
        return None
    found = f"{contacts.min():.1f} to {contacts.max():.1f}"
    return _Doubt(row, "columns 259 to 262", expected="foot contacts near 0 or 1", found=found, sure=True)


def _speed(row: int, motion: np.ndarray) -> _Doubt | None:
    """Joints move faster than any body for the whole motion."""
    if len(motion) < 2:
        return None
    speed = float(np.linalg.norm(np.diff(decode(motion), axis=0), axis=-1).mean())
    if speed <= _FASTEST:
        return None
    expected = f"joints that move less than {_FASTEST * 100:.0f} cm a frame in the mean"
    return _Doubt(row, "columns 0 to 66", expected=expected, found=f"{speed * 100:.0f} cm", sure=True)
