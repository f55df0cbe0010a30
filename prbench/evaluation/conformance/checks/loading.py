"""Can it be loaded, what does it say about itself, and does it refuse what it does not know?"""

from __future__ import annotations

from collections.abc import Iterator

from prbench.errors import PrbenchError
from prbench.evaluation.conformance.check import check
from prbench.evaluation.conformance.finding import Observation, failed, passed, warning
from prbench.evaluation.conformance.subject import Subject


@check("load", "it loads and declares what the harness needs")
def load(subject: Subject) -> Iterator[Observation]:
    """Load it as a run does, fit it if it learns, and read its attributes."""
    try:
        declared, name = subject.declared, subject.adapter.name
    except PrbenchError as error:
        yield failed(str(error), "Nothing else can be looked at before this is repaired.")
        return
    if not isinstance(name, str) or not name:
        yield failed(f"its attribute 'name' is {name!r}.", "Set name to the word that users type behind --method.")
        return
    if name != subject.spec.name and not subject.is_program:
        yield warning(
            f"it calls itself '{name}' but is installed as '{subject.spec.name}'.",
            "Use one name in both places, so that messages and tables speak of the same method.",
        )
        return
    limit = "any length" if declared.max_frames is None else f"up to {declared.max_frames} frames"
    rate = "the table's rate" if declared.native_fps is None else f"{declared.native_fps:g} frames a second"
    yield passed(f"takes {', '.join(item.value for item in subject.conditions)}; {limit}; {rate}.")


CHECKS = (load,)
