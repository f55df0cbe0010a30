"""Read the plug-ins of a group from package metadata, so that one damaged package never hides the others.

``importlib.metadata.entry_points`` gives up on the first line that it cannot parse, and with it every command that
names a plug-in. Here each package is read by itself, and what is wrong with it is said beside its name. Nothing that
is listed gets imported.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import Distribution, EntryPoint, distributions
from typing import Any

from prbench.errors import UsageError, did_you_mean
from prbench.shown import quoted

# The group of methods; a third party finds it as :data:`prbench.contract.ENTRY_POINT_GROUP`.
ADAPTERS = "prbench.adapters"
# The group of methods of motion prediction: ``load(weights, *, options, device) -> Predictor``.
PREDICTORS = "prbench.predictors"
# The group of commands: a word, and the :class:`prbench.cli.commands.Command` or ``Group`` that it runs.
COMMANDS = "prbench.commands"
# The group of tables of the study that stand with their benchmark: a name, and the function that makes the table.
STUDY_ITEMS = "prbench.study_items"
# The group of what estimates bodies from head and wrists (:class:`prbench.curation.poses.three_point.PoseEstimator`).
POSE_ESTIMATORS = "prbench.pose_estimators"
# The group of what text-motion corpora add to other commands: ``find``, ``merge``, ``synthesize`` and ``windows``.
CORPORA = "prbench.corpora"
_OURS = "prbench"  # the distribution whose plug-ins are built in
_UNKNOWN = "unknown"
_TARGET = re.compile(r"[A-Za-z_][\w.]*\s*:\s*[A-Za-z_][\w.]*\s*(\[.*\])?")


@dataclass(frozen=True, order=True)
class InstalledEntry:
    """One plug-in as the metadata of its package name it; nothing of it was imported.

    Attributes:
        name: What it is called by; empty where its line has no name.
        package: Package that offers it.
        version: Version of the package.
        target: Module and object, ``module:object``; empty where its line does not say.
        problem: Reason why it cannot be used: damaged metadata, or a name that is not its own; empty if it can.
        built_in: It comes with prbench itself.
    """

    name: str
    package: str
    version: str
    target: str
    problem: str = ""
    built_in: bool = False


def installed_entries(group: str, *, kind: str = "callable") -> Iterator[InstalledEntry]:
    """Read the lines of a group from the metadata of every installed package.

    Args:
        group: Name of the entry-point group.
        kind: What stands behind the colon, for messages.
    """
    for distribution in _distributions():
        lines = _lines(distribution, group)
        if not lines:
            continue
        package = quoted(_field(distribution, "Name") or _folder_name(distribution) or _UNKNOWN)
        version = quoted(_field(distribution, "Version") or _UNKNOWN)
        ours = _normalised(distribution) == _OURS
        for line in lines:
            name, separator, target = (part.strip() for part in line.partition("="))
            problem = ""
            if not separator or not name:
                problem = f"entry_points.txt: expected 'name = module:{kind}', found '{quoted(line, longest=60)}'"
            elif not _TARGET.fullmatch(target):
                problem = f"entry point: expected 'module:{kind}', found '{quoted(target, longest=60)}'"
            yield InstalledEntry(name, package, version, target, problem, ours)


def load_built_in(group: str, name: str, *, of_others: bool = False) -> Any:
    """Import what prbench's own package offers in a group under a name.

    Args:
        group: Name of the entry-point group.
        name: Name in it.
        of_others: Take what other packages offer, too.

    Raises:
        UsageError: if nobody offers it.
    """
    known = {each.name: each for each in installed_entries(group) if not each.problem and (of_others or each.built_in)}
    if name not in known:
        remedy = f"Installed: {', '.join(sorted(known)) or 'nothing; install prbench again'}."
        raise UsageError(f"nothing named '{name}' in the group '{group}'.{did_you_mean(name, known)} {remedy}")
    return EntryPoint(name, known[name].target, group).load()


def _distributions() -> Iterator[Distribution]:
    """Installed packages; of two copies the one that stands first on the path, as an import would find it."""
    seen = set()
    for distribution in distributions():
        name = _normalised(distribution)
        if name not in seen:
            seen.add(name)
            yield distribution


def _normalised(distribution: Distribution) -> str:
    return re.sub(r"[-_.]+", "-", _folder_name(distribution) or _field(distribution, "Name")).lower()


def _folder_name(distribution: Distribution) -> str:
    """Return the package's name as its ``.dist-info`` folder has it, which costs no reading.

    A source checkout has ``name.egg-info`` without a version.
    """
    stem, _, suffix = str(getattr(getattr(distribution, "_path", None), "name", "")).rpartition(".")
    return stem.partition("-")[0] if suffix in ("dist-info", "egg-info") else ""


def _field(distribution: Distribution, name: str) -> str:
    """``Name`` or ``Version`` from a package's metadata; empty if they cannot be read."""
    try:
        return str(distribution.metadata.get(name) or "")  # type: ignore[attr-defined]  # an email.message.Message
    except Exception:  # whatever a strange installation raises, the others are still to be listed
        return ""


def _lines(distribution: Distribution, group: str) -> list[str]:
    """Return the lines of one group of a package's entry points, comments left out."""
    try:
        text = distribution.read_text("entry_points.txt") or ""
    except (OSError, ValueError):  # unreadable, or no UTF-8
        return []
    found = []
    section = ""
    for line in map(str.strip, text.splitlines()):
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1].strip()
        elif line and line[0] not in "#;" and section == group:
            found.append(line)
    return found
