"""Templates with two marks: ``<<name>>`` is replaced, ``%if`` … ``%else`` … ``%end`` keeps or drops whole lines."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from importlib.resources import files

_PACKAGE = "prbench.workflows.scaffold.templates"
_MARK = re.compile(r"<<(\w+)>>")


def read_template(name: str) -> str:
    """The text of ``NAME.template``."""
    return files(_PACKAGE).joinpath(f"{name}.template").read_text(encoding="utf-8")


def filled(template: str, values: Mapping[str, str], flags: Collection[str]) -> str:
    """A template with its values put in and the lines kept whose conditions hold; an empty value leaves no empty line.

    Args:
        template: Lines; ``%if a and not b`` begins a part that is kept if flag ``a`` is set and ``b`` is not. Parts do
            not nest.
        values: What stands for each ``<<name>>``.
        flags: Those that are set.
    """
    kept, keep = [], True
    for line in template.splitlines():
        word, _, condition = line.partition(" ")
        if word == "%if":
            keep = all(_holds(term.split(), flags) for term in condition.split(" and "))
        elif word == "%else":
            keep = not keep
        elif word == "%end":
            keep = True
        elif keep:
            text = _MARK.sub(lambda mark: values[mark[1]], line)
            kept += [text] if text or not line else []
    return "\n".join(kept) + "\n"


def _holds(term: list[str], flags: Collection[str]) -> bool:
    return (term[-1] in flags) != (term[0] == "not")
