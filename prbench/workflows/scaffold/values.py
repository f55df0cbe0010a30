"""What stands in the templates' places, and which of their parts are kept."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import prbench
from prbench.contract import GIVEN, Condition
from prbench.workflows.scaffold.names import MethodNames
from prbench.workflows.scaffold.templating import read_template

_ROW_FIELDS = {
    "text": 'text=("The person walks to the table and picks the cup.",),',
    "initial_joints": "initial_joints=POSE,",
    "previous_joints": "previous_joints=POSE,",
    "goal_joints": "goal_joints=POSE + (0.0, 0.0, 3.0),",
    "goal_location": "goal_location=np.array([[0.5, 1.0, 3.0]]),",
}


def template_flags(conditions: Sequence[str], *, trainable: bool) -> frozenset[str]:
    """Which optional parts of the templates are kept.

    ``goal`` and ``free`` tell whether the method takes conditions with a first pose and a goal, and without.
    """
    chosen = [Condition(name) for name in conditions]
    given = frozenset[str]().union(*(GIVEN[condition] for condition in chosen))
    flags = {"trainable"} if trainable else set()
    flags |= given & {"text", "goal_location"}
    flags |= {"goal_pose"} if "goal_joints" in given else set()
    flags |= {"goal"} if "initial_joints" in given else set()
    flags |= {"free"} if any("initial_joints" not in GIVEN[condition] for condition in chosen) else set()
    return frozenset(flags)


def template_values(
    names: MethodNames, conditions: Sequence[str], *, trainable: bool, program: bool = False
) -> dict[str, str]:
    """The text for every place in the templates."""
    chosen = list(dict.fromkeys(Condition(name) for name in conditions))
    does = _does("goal" in template_flags(conditions, trainable=trainable))
    return {
        "name": names.method,
        "distribution": names.distribution,
        "module": names.module,
        "class": names.class_name,
        "program": names.program,
        "prbench_version": prbench.__version__.partition("+")[0],
        "condition": chosen[0].value,
        "conditions": ", ".join(f"Condition.{condition.name}" for condition in chosen),
        "condition_words": ", ".join(f'"{condition.value}"' for condition in chosen),
        "what": f"{does[0].upper()}{does[1:]}.",
        "does": does,
        "learns": _LEARNS if trainable else "It has learnt nothing and has no weights.",
        "weights": textwrap.fill(f"**Weights.** {_OWN_WEIGHTS if trainable else _NO_WEIGHTS} {_NEVER}", 120),
        "commands": _aligned(command_lines(names, chosen[0].value, program=program)),
        "row_fields": "\n".join(f"        {_ROW_FIELDS[name]}" for name in _ROW_FIELDS if name in GIVEN[chosen[0]]),
        "standing": _standing_rows(),
    }


def command_lines(names: MethodNames, condition: str, *, program: bool) -> list[tuple[str, str]]:
    """The commands to try in the new folder, in order, each with what it is for."""
    method = f"{names.program}.toml" if program else names.method
    if program:
        first = [("pip install numpy pyarrow", "for the `python` that runs the program")]
    else:
        first = [
            ('pip install -e ".[test]"', "install; prbench finds it by its entry point"),
            ("python -m pytest", "the contract, and what this method promises itself"),
        ]
    return [
        *first,
        (f"prbench adapters check {method}", "the contract, with a report to read"),
        (f"prbench run --method {method} --condition {condition}", "scores, on embedded synthetic data"),
    ]


def _aligned(lines: Sequence[tuple[str, str]]) -> str:
    width = max(len(command) for command, _ in lines)
    return "\n".join(f"{command:<{width}}  # {comment}" for command, comment in lines)


def _does(goal: bool) -> str:
    if goal:
        return "glides the first pose towards the goal, in a straight line"
    return "glides a standing pose two metres ahead"


_LEARNS = "It learns one number, how fast people walk: a run fits it to the training split by itself."
_NEVER = "Never unpickle: safetensors, or `numpy.load(path, allow_pickle=False)`."
_OWN_WEIGHTS = (
    "The template's weights are one number in `speed.json`, which `fit` writes; `--weights speed.json` uses it again,"
    " and `weights_for` names it, so that run.json records its digest. A real model writes its own files in its place."
)
_NO_WEIGHTS = (
    "This template has none and says so. A model reads its own on first use, from the path in `--weights` or from files"
    " in its package (`importlib.resources`), and names them in a method `weights_for(condition) -> Path | None`, so"
    " that run.json records their digest."
)


def _standing_rows() -> str:
    """The rows of the standing pose, as the package's own file has them."""
    return "\n".join(line for line in read_template("standing.py").splitlines() if line.startswith("        ["))
