"""Where one of the 22 joints lies in another skeleton, as an expression: a joint, a mean, a weighted sum, an offset."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from prbench.errors import UsageError, did_you_mean

AXES = ("@up", "@forward", "@left", "@ahead", "@above")
"""Directions of the trunk, each as long as the trunk (middle of the hips to middle of the shoulders): ``@up`` along it,
``@forward`` and ``@left`` across; ``@ahead`` is forward on the ground plane, ``@above`` the vertical."""

_TERM = re.compile(r"(?P<number>\d+\.?\d*|\.\d+)?\s*(?P<name>[@A-Za-z_].*)")
_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Expression:
    """A sum of joints whose weights add up to 1, plus offsets along the axes of the trunk."""

    joints: tuple[tuple[str, float], ...]
    axes: tuple[tuple[str, float], ...] = ()

    def __str__(self) -> str:
        terms = [name if weight == 1 else f"{weight:g} {name}" for name, weight in (*self.joints, *self.axes)]
        return " + ".join(terms).replace("+ -", "- ")


def parse_expression(text: str, known: Iterable[str], *, where: str) -> Expression:
    """``wrist``, ``a + b`` (the mean of two), ``0.6 a + 0.4 b``, ``neck + 0.2 @up - 0.1 @forward``.

    Args:
        text: The expression; spaces around signs.
        known: Names of the source's joints.
        where: What the message begins with.

    Raises:
        UsageError: if a name is unknown (with the nearest one), weights are given to some joints only, or do not add
            up to 1.
    """
    names = list(known)
    joints: list[tuple[str, float | None]] = []
    axes: list[tuple[str, float]] = []
    for sign, term in _signed_terms(text):
        matched = _TERM.fullmatch(term)
        if matched is None:
            raise UsageError(f"{where}: expected joints and numbers such as '0.6 neck + 0.4 head', found '{text}'.")
        name, number = matched["name"].strip(), matched["number"]
        weight = None if number is None and sign > 0 else sign * float(number or 1)
        if name in names:
            joints.append((name, weight))
        elif name in AXES:
            axes.append((name, 1.0 if weight is None else weight))
        else:
            raise UsageError(
                f"{where}: unknown joint '{name}'.{did_you_mean(name, [*names, *AXES])} The source has: "
                f"{', '.join(names)}."
            )
    return Expression(_weighted(joints, text, where), tuple(axes))


def _signed_terms(text: str) -> list[tuple[float, str]]:
    parts = re.split(r"\s+([+-])\s+", text.strip())
    return [(1.0, parts[0])] + [(1.0 if sign == "+" else -1.0, term) for sign, term in zip(parts[1::2], parts[2::2])]


def _weighted(joints: list[tuple[str, float | None]], text: str, where: str) -> tuple[tuple[str, float], ...]:
    given = [weight for _, weight in joints if weight is not None]
    if not given and joints:
        return tuple((name, 1 / len(joints)) for name, _ in joints)
    if len(given) != len(joints) or abs(sum(given) - 1) > _SUM_TOLERANCE:
        raise UsageError(
            f"{where}: expected weights of all joints, which add up to 1, or of none, found '{text}'"
            f" ({sum(given):g} in all)."
        )
    return tuple((name, weight) for name, weight in joints if weight is not None)
