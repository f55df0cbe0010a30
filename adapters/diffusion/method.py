"""The part of the methods that needs no torch: which weights are meant, goals within reach, samples from text."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from prbench.contract import Condition, ConditionBatch
from prbench.errors import AdapterError, did_you_mean
from prbench.geometry.skeleton import Joint
from prbench_adapters.finishing import Finishing

_SUFFIX = ".safetensors"


def late(name: str) -> Callable[..., Any]:
    """Return a function that imports another, ``module:function`` of this package, when it is first called."""

    def imported(*given: Any, **named: Any) -> Any:
        module, _, function = name.partition(":")
        return getattr(importlib.import_module(f"prbench_adapters.{module}"), function)(*given, **named)

    return imported


def bundled_names(folder: Path | None = None) -> list[str]:
    """Names of the bundled weights, sorted: those of one folder, or of all methods that are there."""
    return sorted(_files(folder))


def bundled_weights(name: str, folder: Path | None = None) -> Path:
    """Return the file of bundled weights.

    Args:
        name: Without its suffix.
        folder: Folder that holds them; None for any method's: ``dno``, for one, runs on those of another.

    Raises:
        AdapterError: if there are none of this name; says what there is.
    """
    found = _files(folder)
    if name in found:
        return found[name]
    names = sorted(found)
    hint = did_you_mean(name, names)
    known = ", ".join(names) or "none in this installation"
    problem = f"found none of these.{hint}"
    raise AdapterError(f"weights '{name}': expected a file, a folder, or bundled weights ({known}); {problem}")


def resolve(weights: Path | None, default: str, *, folder: Path | None = None) -> Path:
    """Return the weights file that is meant.

    Args:
        weights: A file; a folder with one weights file in it, such as ``prbench train`` makes; the name of bundled
            weights; None for the default.
        default: Name of bundled weights.
        folder: Folder of the bundled weights; None for any method's.

    Raises:
        AdapterError: if nothing of that kind is there, or the folder holds none or several.
    """
    if weights is None:
        return bundled_weights(default, folder)
    if weights.is_file():
        return weights
    if weights.is_dir():
        found = sorted(weights.glob(f"*{_SUFFIX}"))
        if len(found) == 1:
            return found[0]
        listed = ", ".join(path.name for path in found) or "none"
        remedy = "Name the file."
        raise AdapterError(f"weights {weights}: expected one {_SUFFIX} file in the folder, found {listed}. {remedy}")
    # A path with a folder or a suffix was meant as a path; only a bare word can be a bundled name.
    if len(weights.parts) > 1 or weights.suffix == _SUFFIX:
        raise AdapterError(f"weights {weights}: expected a file or folder, found neither.")
    return bundled_weights(weights.name, folder)


def own_weights(method: str, weights: Path | None) -> Path:
    """Return the weights file that is meant, for a method that runs on none but its own.

    Args:
        method: Its name. The folder ``weights`` beside its code holds those that come with it; ``<method>-small`` is
            the default.
        weights: A file, a folder, a bundled name, or None (:func:`resolve`).

    Raises:
        AdapterError: if nothing of that kind is there; where this version comes without the default, with the command
            that trains some.
    """
    folder = Path(str(files("prbench_adapters"))) / method / "weights"
    default = f"{method}-small"
    if weights is None and default not in bundled_names(folder):
        remedy = f"Train some (`prbench train --method {method} --config small --data …`) and give --weights."
        raise AdapterError(f"{method}: no weights come with this version of prbench. {remedy}")
    return resolve(weights, default, folder=folder)


def _files(folder: Path | None) -> dict[str, Path]:
    """Bundled weights by name; a method that was removed leaves none."""
    # List the folders ``weights`` beside the code of the methods that come with prbench.
    folders = sorted(Path(str(files("prbench_adapters"))).glob("*/weights")) if folder is None else [folder]
    return {path.name.removesuffix(_SUFFIX): path for one in folders for path in one.glob(f"*{_SUFFIX}")}


# Kind of goal of a model, by the condition of the protocol.
GOALS = {Condition.GOAL_LOCATION: "location", Condition.GOAL_POSE: "pose"}
_FARTHEST_GOAL = 10.0
# Metres from the first pelvis, and from the floor: in twelve seconds nobody here comes farther or reaches higher.
_HIGHEST_GOAL = 3.0
# docs/specification/mdm.md#classifier-free-guidance; docs/specification/pr-model.md#sampling-without-optimisation.
TEXT_GUIDANCE = 2.5


def require_goals_within_reach(batch: ConditionBatch, *, adapter: str) -> None:
    """Refuse goals that are not finite or too far away to belong to this motion.

    Args:
        batch: Conditions with initial poses and goals.
        adapter: Who refuses, for the message.

    Raises:
        AdapterError: naming the row, its goal and the distance.
    """
    assert batch.initial_joints is not None
    goal = batch.goal_location if batch.goal_joints is None else batch.goal_joints[:, Joint.PELVIS]
    assert goal is not None
    distance = np.linalg.norm(goal - batch.initial_joints[:, Joint.PELVIS], axis=1)
    # All joints of a goal pose, not the pelvis alone: one NaN is enough to spoil the motion.
    finite = np.isfinite(goal if batch.goal_joints is None else batch.goal_joints.reshape(len(batch), -1)).all(axis=1)
    bad = np.flatnonzero(~finite | ~(distance <= _FARTHEST_GOAL) | (np.abs(goal[:, 1]) > _HIGHEST_GOAL))
    if bad.size:
        row = int(bad[0])
        where = ", ".join(f"{value:.2f}" for value in goal[row])
        raise AdapterError(
            f"adapter '{adapter}', row {row} of the batch (opaque id {batch.opaque_id[row][:12]}): expected a goal"
            f" within {_FARTHEST_GOAL:g} m of the first pose and {_HIGHEST_GOAL:g} m of the floor, found ({where}),"
            f" {distance[row]:.2f} m away. Goals are metres in the canonical frame of the first pose; `prbench view"
            " --data DIR` draws those of a table."
        )


class SingleModelMethod:
    """A method that generates with one model, whatever the condition.

    Args:
        model: The frozen model.
        weights: The file that it came from.
        settings: How it generates.
        finishing: What is done to the motions afterwards; bones and feet unless given.
    """

    def __init__(self, model: Any, weights: Path, settings: Any, *, finishing: Finishing | None = None) -> None:
        self.model, self.weights, self.settings = model, weights, settings
        self.finishing = finishing or Finishing()
        self.max_frames: int | None = getattr(model.configuration, "max_frames", None)
        self.native_fps: float = model.configuration.fps

    def weights_for(self, condition: Condition) -> Path:  # noqa: ARG002 - one model for all
        """Return the weights file in use."""
        return self.weights
