"""Make the bodies that are lacking: run EgoAllo, or write its input folders for whoever runs it by hand.

What EgoAllo wrote is checked before it is put where readers look.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from prbench.curation.poses.config import PosesConfig
from prbench.curation.poses.prepare import guidance_mode, head_poses, prepare, source_trajectory
from prbench.curation.poses.program import run_program
from prbench.curation.poses.states import PoseState, coverage
from prbench.errors import InputFileError, PrbenchError, StorageError
from prbench.files.storage import atomic_folder, lock_file, sole_writer
from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import read_window
from prbench.readers.egoallo.files import EgoalloInputs, find_model, poses_folder

_LOG_FILE = "egoallo.log"
_WORK = "input.partial"
_REPLACED = ".replaced"
_MARK = "prepared-by-prbench.txt"  # a folder without it is somebody else's and is never emptied


@dataclass(frozen=True)
class Outcome:
    """One recording, and what there is or was made of its body."""

    recording_id: str
    """Its name."""
    state: str
    """``made``, ``kept``, ``prepared``, ``failed`` or ``skipped``, or the state of its outputs before."""
    message: str
    """How much the outputs cover, the command to run, or what is wrong."""

    @property
    def failed(self) -> bool:
        """Return True if a body is still lacking."""
        return self.state == "failed"


def make_poses(
    states: Sequence[PoseState],
    config: PosesConfig,
    *,
    root: Path,
    keep_inputs: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
) -> tuple[Outcome, ...]:
    """Make the bodies that are lacking, one recording after the other; what is complete is kept.

    A recording that fails is reported and does not stop the others. After an interruption the same call goes on where
    it stopped: outputs take their place only when they are whole.

    Args:
        states: What there is.
        config: How to run EgoAllo.
        root: The dataset's folder.
        keep_inputs: Leave the prepared folders in place.
        progress: Called with finished recordings, all of them, and the last one's name and state.

    Raises:
        UsageError: if the program cannot be started: nothing else would go better.
        InputFileError: if the body model that the command names does not exist.
        StorageError: if nothing can be written.
    """
    # Checked once, before the first recording takes its minutes.
    model = find_model(root, config.model)
    wanted = any(state.lacking for state in states) and any("{model}" in text for text in config.command)
    if wanted and (model is None or not model.is_file()):
        raise InputFileError(
            model or root / ego.MODEL_FILE,
            "",
            expected="the SMPL-H model, which the command names as {model}",
            found="no such file",
            remedy="Give its path as 'model' in the config.",
        )
    outcomes = []
    for done, state in enumerate(states, start=1):
        outcome = _make(state, config, model, keep_inputs)
        outcomes.append(outcome)
        if progress is not None:
            progress(done, len(states), f"{outcome.recording_id} {outcome.state}")
    return tuple(outcomes)


def _make(state: PoseState, config: PosesConfig, model: Path | None, keep_inputs: bool) -> Outcome:
    name = state.found.recording_id
    work = state.target.parent / _WORK
    if not state.lacking:
        if lock_file(state.target).exists():  # of a process that was killed after its outputs had found their place
            with sole_writer(state.target):
                _clear(work)
        return Outcome(name, "kept" if state.state == "complete" else "skipped", state.message)
    if state.inputs is None:
        return Outcome(name, "failed", state.message)
    lacking = state.inputs.lacking(config.needs)
    if lacking:
        return Outcome(name, "failed", lacking)
    with sole_writer(state.target):
        _clear(work)
        try:
            return _run(state, state.inputs, config, model, work)
        except InputFileError as error:
            return Outcome(name, "failed", str(error))
        finally:
            if not keep_inputs:
                _clear(work)


def _run(state: PoseState, inputs: EgoalloInputs, config: PosesConfig, model: Path | None, work: Path) -> Outcome:
    name = state.found.recording_id
    prepared = prepare(inputs, work)
    prepared.outputs.mkdir(exist_ok=True)
    values = {
        "recording": name,
        "mps": str(prepared.folder),
        "trajectory": str(prepared.trajectory),
        "out": str(prepared.outputs),
        "frames": str(prepared.frames),
        "guidance": guidance_mode(prepared),
        "model": "" if model is None else str(model),
    }
    log = state.target.parent / _LOG_FILE
    ended = run_program(
        config.command_line(values),
        folder=config.folder,
        environment=config.environment,
        log=log,
        timeout=config.timeout_minutes * 60,
    )
    if ended:
        return Outcome(name, "failed", ended)
    outputs = sorted(prepared.outputs.glob("*.npz"))
    if not outputs:
        return Outcome(name, "failed", f"ended well but wrote no output into {ego.OUTPUT_FOLDER}; its log is {log}")
    # EgoAllo ends with code 0 even where it left parts out, so its files are checked and not believed.
    covered = coverage(outputs, head_poses(inputs, source_trajectory(inputs)))
    if not covered.complete:
        return Outcome(name, "failed", f"its outputs cover only {covered}; they are not used; its log is {log}")
    # Readers take whatever lies in this folder for a whole body, so it appears at once or not at all; what was there
    # before keeps a name of its own.
    target = state.target
    with atomic_folder(target) as folder:
        for path in sorted(prepared.outputs.iterdir()):
            if path.suffix in (".npz", ".yaml") and path.is_file():
                shutil.copyfile(path, folder / path.name)
        if target.exists():
            replaced = target.with_name(f"{target.name}{_REPLACED}")
            _clear(replaced)
            target.replace(replaced)
    if model is not None and model.is_file():  # the joints are computed while the model is at hand
        for path in sorted(target.glob("*.npz")):
            read_window(path, model)
    return Outcome(name, "made", f"{len(outputs)} outputs cover {covered}")


def _clear(folder: Path) -> None:
    """Remove a folder of prepared inputs; links go, what they point to stays.

    Raises:
        PrbenchError: if it cannot be removed.
    """
    try:
        shutil.rmtree(folder)
    except FileNotFoundError:
        return
    except OSError as error:
        raise PrbenchError(f"{folder}: cannot be removed ({error.strerror}). Remove it by hand and go on.") from error


def prepare_by_hand(lacking: Sequence[PoseState], root: Path, poses_root: Path | None = None) -> Iterator[Outcome]:
    """Write the input folder of each recording where its outputs belong, so that EgoAllo writes them there.

    Yields:
        The command to run (``prepared``), or what is wrong (``failed``).

    Raises:
        StorageError: if a folder cannot be written, or holds files that prbench did not put there.
    """
    for state in lacking:
        name = state.found.recording_id
        if state.inputs is None:
            yield Outcome(name, "failed", state.message)
            continue
        # By hand there is no config that could say what the command can do without: EgoAllo's own script needs both.
        lacks = state.inputs.lacking(frozenset(("vrs", "points")))
        folder = poses_folder(root.expanduser().resolve(), name, poses_root).parent
        try:
            with sole_writer(folder):
                _clear_prepared(folder)
                prepared = prepare(state.inputs, folder)
        except InputFileError as error:
            yield Outcome(name, "failed", str(error))
            continue
        arguments = f"--traj-length {prepared.frames} --guidance-mode {guidance_mode(prepared)}"
        run = f"python 3_aria_inference.py --traj-root {folder} {arguments}"
        yield Outcome(name, "failed", f"{run}   ({lacks})") if lacks else Outcome(name, "prepared", run)


def _clear_prepared(folder: Path) -> None:
    """Remove what an earlier call wrote into a folder, and nothing else."""
    mark = folder / _MARK
    parts = [folder / mps.SLAM_FOLDER, folder / mps.HAND_FOLDER, *folder.glob("*.vrs")]
    if not mark.is_file() and any(part.exists() for part in parts):
        raise StorageError(f"{folder} holds files that prbench did not put there; choose another --poses-root.")
    for part in parts:
        if part.is_dir() and not part.is_symlink():
            shutil.rmtree(part)
        else:
            part.unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    mark.write_text("Inputs for EgoAllo, made by `prbench poses egoallo --prepare`; its outputs belong beside them.\n")
