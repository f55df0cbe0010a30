"""Defects: what real copies of a dataset suffer from, done to one recording of a freshly written synthetic tree.

A new layout's defects are a new module with a ``DEFECTS`` and one line in :data:`DEFECT_MODULES`.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from prbench.errors import UsageError, did_you_mean

DEFECT_MODULES: dict[str, str] = {
    "adt": "prbench.synthetic.defects.adt",
    "gimo": "prbench.synthetic.defects.gimo",
    "hd-epic": "prbench.synthetic.defects.hd_epic",
    "hot3d": "prbench.synthetic.defects.hot3d",
    "mogaze": "prbench.synthetic.defects.mogaze",
    "nymeria": "prbench.synthetic.defects.nymeria",
    "humanml3d": "prbench.synthetic.defects.humanml3d",
}
"""Module of each preset's defects."""


@dataclass(frozen=True)
class Defect:
    """One thing that goes wrong with files on real disks or in real sensors."""

    name: str
    """Lower case with dashes, for example ``missing-gaze``."""
    what: str
    """One line for the help page."""
    apply: Callable[[Path, str], None]
    """Damages the recording of that id below the tree's root; deterministic."""
    outcome: Literal["failed", "skipped", "read"]
    """What a build must make of the recording: leave it out with a message, or read what is left of it."""
    says: str
    """A part of the message that the user must see; empty where a repair needs no words."""


def defects_of(preset: str) -> tuple[Defect, ...]:
    """All defects of a preset's layout."""
    if preset not in DEFECT_MODULES:
        return ()
    return importlib.import_module(DEFECT_MODULES[preset]).DEFECTS


def defect(preset: str, name: str) -> Defect:
    """One defect by name.

    Raises:
        UsageError: for an unknown one, naming those there are.
    """
    known = {each.name: each for each in defects_of(preset)}
    if name not in known:
        hint = did_you_mean(name, known)
        raise UsageError(f"{preset} has no defect '{name}'.{hint} It has: {', '.join(known) or 'none'}.")
    return known[name]
