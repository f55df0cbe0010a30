"""Array annotations are checked in all tests but those of very many calls, where that would take the most time."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, get_args

import jaxtyping


@contextmanager
def unchecked() -> Iterator[None]:
    """Without the checks; other tests check the same code."""
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", False)


def check_array_annotations(*packages: str) -> None:
    """Check the annotations of each function and data class of these packages that names an array.

    The import hook alone would wrap all 5,800 functions, although pyright has checked what is no array: that took a
    quarter of the time of all tests.
    """
    check = jaxtyping.jaxtyped

    def check_where_arrays_are(*, typechecker: Callable[[Any], Any]) -> Callable[[Any], Any]:
        checked = check(typechecker=typechecker)
        return lambda target: checked(target) if _names_arrays(target) else target

    jaxtyping.jaxtyped = check_where_arrays_are
    jaxtyping.install_import_hook(packages, "beartype.beartype")


def _names_arrays(target: Any) -> bool:
    if isinstance(target, classmethod | staticmethod):
        return _names_arrays(target.__func__)
    if isinstance(target, property):
        return _names_arrays(target.fget)
    if isinstance(target, type):
        if not dataclasses.is_dataclass(target):
            return False
        annotations = target.__init__.__annotations__
    else:
        annotations = getattr(target, "__annotations__", {})
    known = vars(sys.modules[target.__module__])
    names = {name for annotation in annotations.values() for name in re.findall(r"\w+", str(annotation))}
    return any(_is_of_arrays(known.get(name)) for name in names)


def _is_of_arrays(annotation: Any) -> bool:
    """Whether it is a kind of array (``Float``), an array, or a name for a type that has one in it."""
    module = getattr(annotation, "__module__", "")
    return module.partition(".")[0] == "jaxtyping" or any(map(_is_of_arrays, get_args(annotation)))
