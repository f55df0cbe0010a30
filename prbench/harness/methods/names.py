"""The one rule for names of methods: prbench's own belong to prbench, and all others have a form that can be shown.

A package, a program, a file of motions and a run folder in a leaderboard are asked the same question by
:func:`name_problem`. Names are compared without case and punctuation, so that ``Ground_Truth`` passes for nothing.
"""

from __future__ import annotations

import re
from collections.abc import Collection

from prbench.protocol.benchmarks import default_benchmark
from prbench.shown import quoted

GROUND_TRUTH = "ground-truth"
GROUND_TRUTH_RESAMPLED = "ground-truth-resampled"
GROUND_TRUTH_20_FPS = "ground-truth-20fps"
GROUND_TRUTH_30_FPS = "ground-truth-30fps"
SCRIPTED = "scripted"
STARE = "stare"
STARE_LATE = "stare-late"
TREMOR = "tremor"
TELEPORT = "teleport"
FLOAT = "float"
NEAREST_NEIGHBOUR = "nearest-neighbour"
SHUFFLED_GOAL = "shuffled-goal"

METHOD_CONTROLS = (
    GROUND_TRUTH,
    GROUND_TRUTH_RESAMPLED,
    GROUND_TRUTH_20_FPS,
    GROUND_TRUTH_30_FPS,
    SCRIPTED,
    STARE,
    STARE_LATE,
    TREMOR,
    TELEPORT,
    FLOAT,
    NEAREST_NEIGHBOUR,
)
"""Controls that ``--method`` takes."""
BUILT_IN_METHODS = default_benchmark().methods
"""Methods of the default benchmark that come with prbench, installed or not."""

_WORDS = ("all", "prbench", "shuffled", "t2m-evaluator")
"""Words that mean something else in commands and tables."""
_LONGEST = 100
_FORM = re.compile(r"[A-Za-z0-9]([A-Za-z0-9 ._+()-]*[A-Za-z0-9.+)])?")
NAME_FORM = f"1 to {_LONGEST} characters of A to Z, a to z, 0 to 9, space and . _ + - ( ), first a letter or a digit"
"""Form of a name, in words. Other alphabets hold letters that look like these and are not."""


def has_form(name: object) -> bool:
    """Return True where a name has the form that every method's name has, prbench's own too."""
    return isinstance(name, str) and len(name) <= _LONGEST and _FORM.fullmatch(name) is not None


def name_problem(name: object, *, own: Collection[str] = ()) -> str | None:
    """Say what is wrong with the name that a package, a program or a file gives its method.

    Args:
        name: As it was given.
        own: Further methods of prbench itself: those of the benchmark in question.

    Returns:
        A clause without a full stop, or None if the name can be used.
    """
    if not has_form(name):
        return f"expected a name of {NAME_FORM}, found {quoted(repr(name))}"
    owners = _OWNERS | {_bare(each): _OWN_METHOD for each in own}
    owner = owners.get(_bare(str(name)))
    return None if owner is None else f"'{name}' is {owner}; only prbench itself may use this name"


def _bare(name: str) -> str:
    """Return a name as a quick reader takes it in: small letters and digits."""
    return re.sub(r"[^a-z0-9]", "", name.casefold())


_OWN_METHOD = "a method of prbench itself"
_OWNERS = {
    **{_bare(name): "a reserved word of prbench" for name in _WORDS},
    **{_bare(name): _OWN_METHOD for name in BUILT_IN_METHODS},
    **{_bare(name): "a control of prbench" for name in (*METHOD_CONTROLS, SHUFFLED_GOAL)},
}
