"""Find the mutants of an older tree in a newer one, whose modules have moved and whose statements are reworded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import PurePosixPath

from tests.mutation.mutants import Mutant


def find(old: Mutant, mutants: list[Mutant]) -> Mutant | None:
    """Find the same mistake in another tree.

    Tried in this order: the same statement in a function of the same name, the same expression in a function of the
    same name, the same expression in a module of the same name, the same expression anywhere.

    Args:
        old: Mutant of the older tree.
        mutants: All mutants of the newer tree.

    Returns:
        The mutant; None where no rule finds any, or the best rule finds several in several modules.
    """
    same_change = [
        new for new in mutants if (new.operator, new.before, new.after) == (old.operator, old.before, old.after)
    ]
    rules: tuple[Callable[[Mutant], bool], ...] = (
        lambda new: _place(new) == _place(old),
        lambda new: new.function == old.function,
        lambda new: _last_name(new) == _last_name(old),
        lambda new: PurePosixPath(new.module).name == PurePosixPath(old.module).name,
        lambda new: True,
    )
    for rule in rules:
        found = [new for new in same_change if rule(new)]
        if len(found) > 1:
            found = _nearest(old, found)
        if len(found) == 1:
            return found[0]
        if found:
            return None
    return None


def _place(mutant: Mutant) -> tuple[str, str, int]:
    return mutant.function, mutant.statement, mutant.occurrence


def _last_name(mutant: Mutant) -> str:
    return mutant.function.rpartition(".")[2].lstrip("_")


def _nearest(old: Mutant, found: list[Mutant]) -> list[Mutant]:
    same_module = [new for new in found if PurePosixPath(new.module).name == PurePosixPath(old.module).name]
    same_occurrence = [new for new in same_module if new.occurrence == old.occurrence]
    return same_occurrence or same_module or found
