"""Templates and values of a new predictor of motion prediction."""

from __future__ import annotations

from collections.abc import Sequence

from prbench.checking.scaffold.values import MethodNames, aligned, common_values, first_commands
from prbench.prediction.batch import Condition
from prbench.protocol.manifests import find_benchmark

BENCHMARK = "motion-prediction"
_DOES = "lets the last pose go on, at a speed that differs from sample to sample"
_LEARNS = "It learns one number, how much of their speed people keep: a run fits it to the training windows by itself."


def flags(conditions: Sequence[str], *, trainable: bool) -> frozenset[str]:
    """Return the names of the optional parts that are kept."""
    given = {"gaze"} if set(conditions) - {Condition.POSE.value} else set()
    return frozenset(given | ({"trainable"} if trainable else set()))


def values(names: MethodNames, conditions: Sequence[str], *, trainable: bool, program: bool) -> dict[str, str]:
    """Return the text for every place in the templates."""
    chosen = list(dict.fromkeys(Condition(name) for name in conditions))
    lines = commands(names, chosen[0].value, program=program)
    return common_values(names, chosen, _DOES) | {
        "described": f"The predictor '{names.method}' for the motion prediction benchmark of prbench.",
        "entry_points": find_benchmark(BENCHMARK).entry_points,
        "run": f"{_run(names, chosen[0].value, program=True)} --data WINDOWS",
        "learns": _LEARNS if trainable else "It has learnt nothing and has no weights.",
        "commands": aligned(lines),
    }


def commands(names: MethodNames, condition: str, *, program: bool) -> list[tuple[str, str]]:
    """Return the commands to try in the new folder, in order, each with what it is for."""
    method = f"{names.program}.toml" if program else names.method
    return [
        *first_commands(program=program),
        (f"prbench adapters check {method} --benchmark {BENCHMARK}", "the contract, with a report to read"),
        ("prbench synthesize adt --table --out adt", "synthetic people, if you have no recordings"),
        ("prbench build-windows --data adt --out windows", "windows up to their primes and events"),
        (f"{_run(names, condition, program=program)} --data windows", "scores"),
    ]


def _run(names: MethodNames, condition: str, *, program: bool) -> str:
    method = f"{names.program}.toml" if program else names.method
    return f"prbench run --benchmark {BENCHMARK} --method {method} --condition {condition}"
