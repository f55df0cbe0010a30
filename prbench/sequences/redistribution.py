"""One rule for every view, export and run of what a dataset's licence lets leave its holder's machine.

``none``: recorded motion and goal poses are left out or refused unless the user states permission for that dataset;
``non-commercial``: they may be passed on, with a notice; ``yes``: they may be passed on.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Protocol, runtime_checkable

from prbench.errors import RedistributionError

NOTICE_FILE = "NOTICE.txt"
"""Stands beside recorded motion that leaves a table."""

_STRICTEST_FIRST = ("none", "non-commercial", "yes")


@runtime_checkable
class _HasTerms(Protocol):
    """Anything that says under which terms a dataset's recordings stand (``DatasetInfo``, ``TableRecord`` …)."""

    @property
    def dataset(self) -> str:
        """Name of the dataset."""
        ...

    @property
    def title(self) -> str:
        """Its title, for people."""
        ...

    @property
    def redistribution(self) -> str:
        """``none``, ``non-commercial`` or ``yes``; anything else counts as ``none``."""
        ...


def may_pass_on(terms: _HasTerms, permitted: Collection[str] = ()) -> bool:
    """Return True if recorded motion and goal poses may stand in a view or export.

    Args:
        terms: Of the dataset.
        permitted: Datasets for which the user has the licensor's permission, by name.
    """
    return _known(terms.redistribution) != "none" or terms.dataset in permitted


def require_may_pass_on(terms: _HasTerms, what: str, permitted: Collection[str] = ()) -> None:
    """Refuse to write what the licence keeps.

    Args:
        terms: Of the dataset.
        what: What would be written, for the message.
        permitted: See :func:`may_pass_on`.

    Raises:
        RedistributionError: if the licence forbids it and no permission is stated.
    """
    if not may_pass_on(terms, permitted):
        raise RedistributionError(
            f"{terms.title} ({terms.dataset}): its licence does not let recorded motion and goal poses be passed on,"
            f" and {what} would hold them. If the licensor has given you permission, say so:"
            f" --permission {terms.dataset}"
        )


def notice(terms: _HasTerms, permitted: Collection[str] = ()) -> str:
    """The sentence that a view or export of the dataset's recordings carries; empty where nothing has to be said."""
    if _known(terms.redistribution) == "yes":
        return ""
    if terms.redistribution == "non-commercial":
        return f"{terms.title}: for non-commercial purposes only, under the dataset's own licence."
    if terms.dataset in permitted:
        return f"{terms.title}: holds recorded motion by permission that the user states; do not pass it on further."
    return f"{terms.title}: recorded motion and goal poses must not be passed on; left out here."


def run_notice(terms: _HasTerms, *, recorded_motion: bool) -> str:
    """Return the notice of a run folder about the motions in it; empty where nothing has to be said.

    A run stays with whoever has the data, so nothing is refused; passing the folder on is the user's act.

    Args:
        terms: Of the dataset that was run on.
        recorded_motion: The predictions are the recorded motion itself (the ground-truth control).
    """
    kind = _known(terms.redistribution)
    if kind == "yes":
        return ""
    held = "the recorded motion itself" if recorded_motion else "motions generated from recorded goals and first poses"
    if kind == "non-commercial":
        return f"{terms.title}: the predictions are {held}; for non-commercial purposes only.\n"
    rule = "they must not leave your machine" if recorded_motion else "recorded poses in them must not be passed on"
    return f"{terms.title}: the predictions are {held}; {rule} without the licensor's permission. Scores may.\n"


def strictest(redistributions: Iterable[str]) -> str:
    """The terms of data that stand under several licences at once."""
    return min((_known(kind) for kind in redistributions), key=_STRICTEST_FIRST.index, default="none")


def _known(redistribution: str) -> str:
    """The kind, or the strictest one for a word that is not known."""
    # A word from a newer version may forbid more than this one knows.
    return redistribution if redistribution in _STRICTEST_FIRST else "none"
