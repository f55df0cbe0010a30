"""Count the parameters of the networks that a method in this process holds."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any

_DEEPEST = 6  # attributes of attributes; the built-in methods hold their networks at most three deep


def count_parameters(method: object) -> int | None:
    """Return the number of parameters of all PyTorch modules that are reachable from an object's attributes.

    A module counts once, however often it is held; buffers do not count. None without PyTorch and without modules, as
    for a method that runs as a program of its own.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        return None
    parameters = {
        id(parameter): parameter.numel()
        for module in _modules(method, torch.nn.Module, set(), _DEEPEST)
        for parameter in module.parameters()
    }
    return sum(parameters.values()) if parameters else None


def _modules(held: Any, kind: type, seen: set[int], depth: int) -> Iterator[Any]:
    if id(held) in seen or depth < 0:
        return
    seen.add(id(held))
    if isinstance(held, kind):
        yield held
        return
    if isinstance(held, Mapping):
        inner = list(held.values())
    elif isinstance(held, (list, tuple)):
        inner = list(held)
    else:
        inner = [*getattr(held, "__dict__", {}).values()]
        slots = getattr(type(held), "__slots__", ())
        inner += [getattr(held, name) for name in slots if isinstance(name, str) and hasattr(held, name)]
    for each in inner:
        # Neither classes nor code hold the networks of this method alone.
        if not isinstance(each, (type, str, bytes, int, float)) and not _is_code(each):
            yield from _modules(each, kind, seen, depth - 1)


def _is_code(held: object) -> bool:
    """Return True for functions and modules of Python, which hold the whole program."""
    return type(held).__name__ in ("function", "module", "builtin_function_or_method")
