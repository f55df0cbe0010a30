"""Declarations of installed methods: each is imported, loaded and asked."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from prbench.errors import PrbenchError
from prbench.harness.methods.installed import InstalledEntry, list_adapters, offered_twice
from prbench.harness.methods.loading import load_adapter
from prbench.harness.methods.motions import Declared
from prbench.harness.methods.remote import group_of
from prbench.protocol.manifests import PROTOCOL_NAME

_LONGEST_LINE = 300  # characters


@dataclass(frozen=True)
class Description:
    """One installed method, imported and asked, or the reason why it could not be.

    Attributes:
        method: Its package metadata.
        conditions: Conditions that it can be given, of those of its benchmark.
        fitted: It learns from a table (``fit``), so a run fits it by itself when it is given no weights.
        max_frames: Longest motion that it generates, in frames; None if there is no limit.
        native_fps: Rate of its motions in frames per second; None if it takes any.
        motionless: Its motions stand still.
        weights: Files or folders that it brings, over all its conditions.
        error: Reason in one line; empty if there is none.
    """

    method: InstalledEntry
    conditions: tuple[str, ...] = ()
    fitted: bool = False
    max_frames: int | None = None
    native_fps: float | None = None
    motionless: bool = False
    weights: tuple[str, ...] = ()
    error: str = ""


def describe_adapters(names: Iterable[str] | None = None, *, benchmark: str = PROTOCOL_NAME) -> list[Description]:
    """Import the installed methods and say what each declares; one that cannot be imported costs one line.

    Args:
        names: Names of methods; None for all.
        benchmark: Whose methods are meant.

    Returns:
        One description a method, in the order of :func:`~prbench.harness.methods.installed.list_adapters`.
    """
    group = group_of(benchmark)
    installed = list_adapters(group.entry_points)
    wanted = None if names is None else frozenset(names)
    twice = offered_twice(installed)
    found = []
    for method in installed:
        if wanted is not None and method.name not in wanted:
            continue
        if method.problem or method.name in twice:
            found.append(Description(method, error=method.problem or "another package offers the same name"))
            continue
        try:
            # What a package prints while it is imported is no part of the list.
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                adapter = load_adapter(method.name, None, {}, "cpu", group=group)
                declared = Declared.by(adapter, origin="it", conditions=group.conditions)
                weights_for = getattr(adapter, "weights_for", None)
                paths = [weights_for(each) for each in sorted(declared.conditions)] if weights_for is not None else []
        except PrbenchError as error:
            origin = f"adapter '{method.name}' (package {method.package} {method.version}, {method.target}): "
            line = " ".join(str(error).removeprefix(origin).rstrip(".").split())
            shown = line if len(line) <= _LONGEST_LINE else line[: _LONGEST_LINE - 2] + " …"
            found.append(Description(method, error=shown))
            continue
        description = Description(
            method,
            conditions=tuple(sorted(condition.value for condition in declared.conditions)),
            fitted=hasattr(adapter, "fit"),
            **{name: getattr(declared, name) for name in ("max_frames", "native_fps", "motionless")},
            weights=tuple(sorted({Path(path).name for path in paths if path is not None})),
        )
        found.append(description)
    return found
