"""The command line of ``prbench run`` as an experiment, whose file may say what the command line does not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import msgspec

from prbench.errors import UsageError

if TYPE_CHECKING:
    from prbench.harness.experiment import Experiment
    from prbench.harness.run_folder import RunFolder

_OF_AN_EXPERIMENT = ("benchmark", "method", "condition", "options", "control", "sequences", "minutes")
"""Options whose place is in the file, where there is one."""

_SHARED = (
    "data",
    "out",
    "split",
    "fold",
    "limit",
    "samples",
    "best_of",
    "carry_on",
    "batch_size",
    "device",
    "threads",
    "isolate",
    "timeout",
    "seed",
    "protocol",
)
"""Options that all runs of an experiment share; their names are its keys, but for ``seeds``."""


def read_command_line(config: Path | None, given: Mapping[str, Any]) -> tuple[RunFolder | None, Experiment]:
    """Turn the command line into an experiment; also return the run that it repeats, if it repeats one.

    Raises:
        UsageError: for an option whose place is in the file that was named.
    """
    from prbench.harness.experiment import Experiment, ExperimentMethod, experiment_of_run, read_experiment, run_of

    own = _said_on_the_command_line(given)
    if config is None:
        method = ExperimentMethod(
            name=given["method"],
            conditions=(given["condition"],) if given["condition"] else (),
            weights=str(given["weights"]) if given["weights"] else None,
            options=dict(given["options"]),
            control=given["control"],
        )
        benchmark = {"benchmark": given["benchmark"]} if given["benchmark"] else {}
        return None, msgspec.convert(
            {"methods": [msgspec.to_builtins(method)], "sequences": given["sequences"], **own, **benchmark}, Experiment
        )
    for name in _OF_AN_EXPERIMENT:
        if given.get(name):
            option = name.removesuffix("s") if name in ("options", "sequences") else name
            raise UsageError(f"--{option}: {config} says that already; write it there, or leave --config out.")
    repeated = run_of(config)
    if repeated is None:
        experiment = read_experiment(config)
        if given["weights"]:
            raise UsageError(f"--weights: write them into {config}, beside the method that they belong to.")
    else:
        experiment = experiment_of_run(repeated, data=given["data"], weights=given["weights"])
        own.pop("data", None)  # found by digest among the named ones
    return repeated, msgspec.structs.replace(experiment, **own)


def _said_on_the_command_line(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of an experiment that the command line sets; defaults do not replace what a file says."""
    context = click.get_current_context()
    said = {
        name: given[name]
        for name in _SHARED
        if context.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
    }
    if "data" in said:
        said["data"] = tuple(str(folder) for folder in said["data"])
    for name in ("out", "protocol"):
        if name in said:
            said[name] = str(said[name])
    if "seed" in said:
        said["seeds"] = (said.pop("seed"),)
    return said
