"""One sequence by what a person types of its id."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from prbench.errors import UsageError

_SHOWN = 8  # ids that an error message lists


def find_sequence_id(wanted: str, known: Sequence[str], *, among: str) -> str:
    """The id that is meant: itself, or the only one that begins or ends with, or else holds, what was typed.

    Args:
        wanted: What was typed.
        known: All ids.
        among: What they belong to, for the message.

    Raises:
        UsageError: if none or several fit; names the nearest ids, or those that fit.
    """
    if wanted in known:
        return wanted
    fitting: list[str] = []
    if wanted:
        ends = [name for name in known if name.startswith(wanted) or name.endswith(wanted)]
        fitting = ends or [name for name in known if wanted in name]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        more = f"\n  … and {len(fitting) - _SHOWN} more" if len(fitting) > _SHOWN else ""
        raise UsageError(
            f"'{wanted}' fits {len(fitting)} sequences of {among}; give a longer part of one:\n{_lines(fitting)}{more}"
        )
    near = nearest_ids(wanted, known)
    hint = f" Near it:\n{_lines(near)}" if near else ""
    raise UsageError(f"no sequence '{wanted}' among the {len(known)} of {among}.{hint}")


def nearest_ids(wanted: str, known: Sequence[str]) -> list[str]:
    """Up to three ids of which a part between slashes, as long as what was typed, looks like it."""
    length = wanted.count("/") + 1
    whole: dict[str, str] = {}
    for name in known:
        parts = name.split("/")
        for start in range(max(len(parts) - length, 0) + 1):
            whole.setdefault("/".join(parts[start : start + length]), name)
    near = difflib.get_close_matches(wanted, whole, n=12, cutoff=0.0)
    return list(dict.fromkeys(whole[part] for part in near))[:3]


def _lines(names: Sequence[str]) -> str:
    return "\n".join(f"  {name}" for name in names[:_SHOWN])
