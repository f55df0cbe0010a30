"""Make bodies with EgoAllo: the user's configuration, one program a recording, and the files that come back.

The configuration is a small TOML file that the user writes once; whoever has none yet gets the instructions.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Annotated

import msgspec

from prbench.curation.poses.states import PoseState, coverage, head_poses, prepare, source_trajectory
from prbench.errors import InputFileError, PrbenchError, StorageError, UsageError
from prbench.files.bounded import copy_file, foreign_input, read_end, read_toml, require, structured
from prbench.files.storage import atomic_folder, lock_file, sole_writer
from prbench.progress_bar import ProgressCallback
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import HOW_TO_GET
from prbench.readers.egoallo.files import EgoalloInputs, Need, find_model

# What may stand in braces in a command; :func:`_run` fills them.
_PLACEHOLDERS = ("python", "recording", "mps", "trajectory", "out", "frames", "guidance", "model")

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
# EgoAllo's own script (repository brentyi/egoallo, commit 0c20ae8).
_DEFAULT_COMMAND = (
    "{python}", "3_aria_inference.py", "--traj-root", "{mps}", "--traj-length", "{frames}",
    "--guidance-mode", "{guidance}", "--smplh-npz-path", "{model}",
)  # fmt: skip


class PosesConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[egoallo]`` of a config file.

    Attributes:
        python: Interpreter of the environment in which EgoAllo is installed.
        folder: EgoAllo's repository: the command runs there.
        command: Program and arguments, one text each; never a line for a shell.
        model: The SMPL-H model; found as the readers find it if None.
        needs: Inputs that EgoAllo cannot do without; ``points`` tell it the floor, ``vrs`` the calibration.
        timeout_minutes: Longest time for one recording.
        environment: Further environment variables, for example ``CUDA_VISIBLE_DEVICES``.
    """

    python: str
    folder: Path
    command: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] = _DEFAULT_COMMAND
    model: Path | None = None
    needs: frozenset[Need] = frozenset(("vrs", "points"))
    timeout_minutes: Annotated[float, msgspec.Meta(gt=0)] = 120.0
    environment: dict[str, str] = {}

    def command_line(self, values: Mapping[str, str]) -> list[str]:
        """Return the command with its placeholders filled; texts stay single arguments whatever they hold."""
        # Filled per argument and never joined: a path with spaces or quotes stays one argument, and no shell sees it.
        filled = {"python": self.python} | dict(values)
        return [_PLACEHOLDER.sub(lambda match: filled[match[1]], text) for text in self.command]


class _ConfigFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    egoallo: PosesConfig


@foreign_input()
def read_config(path: Path) -> PosesConfig:
    """Read a config file; relative paths in it are relative to its folder.

    Raises:
        InputFileError: if it is missing, no TOML, lacks a key or holds an unknown one, or its command has an unknown
            placeholder.
    """
    expected = "a table [egoallo] with python and folder"
    remedy = "`prbench poses egoallo --root DIR` without --config prints one to start from."
    config = structured(path, read_toml(path, expected, remedy), _ConfigFile, remedy=remedy).egoallo
    unknown = [name for text in config.command for name in _PLACEHOLDER.findall(text) if name not in _PLACEHOLDERS]
    expected = f"the placeholders {', '.join(f'{{{name}}}' for name in _PLACEHOLDERS)}"
    require(path, (not unknown, "egoallo.command", expected, f"{{{''.join(unknown[:1])}}}", ""))
    base = path.expanduser().absolute().parent
    model = None if config.model is None else base / config.model.expanduser()
    # A bare name such as python3.12 is found on PATH; anything with a separator is a path relative to the file.
    looks_like_path = "/" in config.python or "\\" in config.python
    python = str(base / Path(config.python).expanduser()) if looks_like_path else config.python
    return msgspec.structs.replace(config, python=python, folder=base / config.folder.expanduser(), model=model)


def instructions(root: Path, lacking: Sequence[PoseState]) -> str:
    """Commands that lead to the bodies which are lacking."""
    example = lacking[0].target if lacking else root / ego.POSES_FOLDER / "RECORDING" / ego.OUTPUT_FOLDER
    template = files("prbench.curation.poses").joinpath("instructions.template").read_text(encoding="utf-8")
    return template.format(how_to_get=HOW_TO_GET, root=root, target=example, model=ego.MODEL_FILE)


_GRACE = 5.0  # seconds between asking a program to end and ending it
_TAIL_BYTES = 4096
_TAIL_LINES = 3
_UNPRINTABLE = re.compile(r"[^\x20-\x7e]+")


def _run_program(command: Sequence[str], config: PosesConfig, log: Path) -> str:
    """Run a program without a shell, everything it prints into a log, and end it when its time is up.

    Returns:
        What went wrong, with the last words of the log; empty if nothing.

    Raises:
        UsageError: if it cannot be started.
        StorageError: if the log cannot be written.
    """
    try:
        log.parent.mkdir(parents=True, exist_ok=True)
        output = open(log, "wb")  # noqa: SIM115 (closed by the with below)
    except OSError as error:
        raise StorageError(f"{log}: cannot be written ({error.strerror}). Choose another folder.") from error
    with output:
        try:
            process = subprocess.Popen(
                command,
                cwd=config.folder,
                env={**os.environ, **config.environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=os.name == "posix",  # a group of its own, so that its children can be ended with it
            )
        except OSError as error:
            problem = f"cannot start {command[0]} in {config.folder}: {error.strerror}."
            raise UsageError(f"{problem} Check python, folder and command in the config.") from error
        try:
            code = process.wait(config.timeout_minutes * 60)
            how = f"ended with exit code {code}" if code else ""
        except subprocess.TimeoutExpired:
            how = "ran out of time"
        finally:
            # End the program and what it started; nothing to do where it has ended and has no children.
            # Also after a good end: a child that still runs would hold the GPU.
            _signal(process, signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(_GRACE)
            # The group may outlive its leader, and only POSIX has groups.
            if process.poll() is None or os.name == "posix":
                _signal(process, getattr(signal, "SIGKILL", signal.SIGTERM))
            process.wait()
    if not how:
        return ""
    # The last lines that can be printed, whatever else the log holds.
    text = read_end(log, _TAIL_BYTES).decode("utf-8", errors="replace")
    lines = [_UNPRINTABLE.sub(" ", line).strip()[-160:] for line in text.splitlines()]
    kept = [line for line in lines if line][-_TAIL_LINES:]
    said = f" ('{' / '.join(kept)}')" if kept else ""
    return f"{how}{said}; its log is {log}"


def _signal(process: subprocess.Popen[bytes], number: int) -> None:
    """Send a signal to the whole group where there are groups, so that children of the program end too."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        if os.name == "posix":
            os.killpg(process.pid, number)
        elif process.poll() is None:
            process.terminate()


_LOG_FILE = "egoallo.log"
_WORK = "input.partial"
_REPLACED = ".replaced"


@dataclass(frozen=True)
class Outcome:
    """One recording, and what there is or was made of its body.

    Attributes:
        recording_id: Its name.
        state: ``made``, ``kept``, ``failed`` or ``skipped``; or of EgoAllo's outputs before anything was done:
            ``complete``; ``partial``, covering a part; ``refused``, of another recording or damaged; ``missing``;
            ``unreadable``, without a trajectory to make any from; or ``skipped``, of a recording known to be bad.
        message: How much the outputs cover, or what is wrong.
    """

    recording_id: str
    state: str
    message: str

    @property
    def failed(self) -> bool:
        """Return True if a body is still lacking."""
        return self.state == "failed"


def make_poses(
    states: Sequence[PoseState], config: PosesConfig, *, root: Path, progress: ProgressCallback | None = None
) -> tuple[Outcome, ...]:
    """Make the bodies that are lacking, one recording after the other; what is complete is kept.

    A recording that fails is reported and does not stop the others. After an interruption the same call goes on where
    it stopped: outputs take their place only when they are whole.

    Args:
        states: What there is.
        config: How to run EgoAllo.
        root: The dataset's folder.
        progress: Called with finished recordings, all of them, and the last one's name and state.

    Raises:
        UsageError: if the program cannot be started: nothing else would go better.
        InputFileError: if the body model that the command names does not exist.
        StorageError: if nothing can be written.
    """
    # Checked once, before the first recording takes its minutes.
    model = find_model(root, config.model)
    wanted = any(state.lacking for state in states) and any("{model}" in text for text in config.command)
    there = not wanted or (model is not None and model.is_file())
    expected = "the SMPL-H model, which the command names as {model}"
    remedy = "Give its path as 'model' in the config."
    require(model or root / ego.MODEL_FILE, (there, "", expected, "no such file", remedy))
    outcomes = []
    for done, state in enumerate(states, start=1):
        outcome = Outcome(state.found.recording_id, *_make(state, config, model))
        outcomes.append(outcome)
        if progress is not None:
            progress(done, len(states), f"{outcome.recording_id} {outcome.state}")
    return tuple(outcomes)


def _make(state: PoseState, config: PosesConfig, model: Path | None) -> tuple[str, str]:
    """Make one body; return what became of it, and how much is covered or what is wrong."""
    work = state.target.parent / _WORK
    if not state.lacking:
        if lock_file(state.target).exists():  # of a process that was killed after its outputs had found their place
            with sole_writer(state.target):
                _clear(work)
        return "kept" if state.state == "complete" else "skipped", state.message
    if state.inputs is None:
        return "failed", state.message
    if lacking := state.inputs.lacking(config.needs):
        return "failed", lacking
    with sole_writer(state.target):
        _clear(work)
        try:
            return _run(state, state.inputs, config, model, work)
        except InputFileError as error:
            return "failed", str(error)
        finally:
            _clear(work)


def _run(
    state: PoseState, inputs: EgoalloInputs, config: PosesConfig, model: Path | None, work: Path
) -> tuple[str, str]:
    trajectory, frames = prepare(inputs, work)
    produced = work / ego.OUTPUT_FOLDER
    produced.mkdir(exist_ok=True)
    # By tracked wrists where there are some, as the study does, else by feet alone.
    guidance = "no_hands" if inputs.wrists is None else "aria_wrist_only"
    values = {"recording": state.found.recording_id, "frames": str(frames), "guidance": guidance}
    values |= {"mps": str(work), "trajectory": str(trajectory), "out": str(produced), "model": str(model or "")}
    log = state.target.parent / _LOG_FILE
    if ended := _run_program(config.command_line(values), config, log):
        return "failed", ended
    outputs = sorted(produced.glob("*.npz"))
    if not outputs:
        return "failed", f"ended well but wrote no output into {ego.OUTPUT_FOLDER}; its log is {log}"
    # EgoAllo ends with code 0 even where it left parts out, so its files are checked and not believed.
    complete, covered = coverage(outputs, head_poses(inputs, source_trajectory(inputs)))
    if not complete:
        return "failed", f"its outputs cover only {covered}; they are not used; its log is {log}"
    # Readers take whatever lies in this folder for a whole body, so it appears at once or not at all; what was there
    # before keeps a name of its own.
    target = state.target
    with atomic_folder(target) as folder:
        for path in sorted(produced.iterdir()):
            if path.suffix in (".npz", ".yaml") and path.is_file():
                copy_file(path, folder / path.name)
        if target.exists():
            replaced = target.with_name(f"{target.name}{_REPLACED}")
            _clear(replaced)
            target.replace(replaced)
    return "made", f"{len(outputs)} outputs cover {covered}"


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
