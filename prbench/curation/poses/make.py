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
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import msgspec

from prbench.curation.poses.states import PoseState, coverage, guidance_mode, head_poses, prepare, source_trajectory
from prbench.errors import InputFileError, PrbenchError, StorageError, UsageError
from prbench.files.bounded import foreign_input, read_text
from prbench.files.storage import atomic_folder, lock_file, sole_writer
from prbench.limits import HARMLESS_SIZE
from prbench.readers.aria_mps import format as mps
from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.bodies import HOW_TO_GET
from prbench.readers.egoallo.files import EgoalloInputs, Need, find_model, poses_folder

_PLACEHOLDERS = {
    "python": "the interpreter named in the config",
    "recording": "name of the recording",
    "mps": "folder with slam/, hand_tracking/ and a link to the VRS file: EgoAllo's --traj-root",
    "trajectory": "the trajectory file in it",
    "out": "folder where outputs must appear ({mps}/egoallo_outputs)",
    "frames": "frames that cover the whole recording: EgoAllo's --traj-length",
    "guidance": "aria_wrist_only where wrists were tracked, else no_hands: EgoAllo's --guidance-mode",
    "model": "the SMPL-H model",
}
"""Placeholders that may stand in braces in a command, and their meanings."""

_PLACEHOLDER = re.compile(r"\{(\w+)\}")
_DEFAULT_COMMAND = (
    "{python}", "3_aria_inference.py", "--traj-root", "{mps}", "--traj-length", "{frames}",
    "--guidance-mode", "{guidance}", "--smplh-npz-path", "{model}",
)  # fmt: skip
"""EgoAllo's own script (repository brentyi/egoallo, commit 0c20ae8)."""
_INSTALL = """\
EgoAllo estimates bodies from the glasses' path; prbench reads its outputs and can run it, but does not contain it.
It needs Python 3.12 or newer and an NVIDIA GPU (repository brentyi/egoallo, MIT; commands of commit 0c20ae8):

  git clone https://github.com/brentyi/egoallo.git
  cd egoallo
  python3.12 -m venv .venv && . .venv/bin/activate
  pip install -e .
  pip install "jax[cuda12]==0.6.1" git+https://github.com/brentyi/jaxls.git
  bash download_checkpoint_and_data.sh        # 0.6 GB checkpoint, then 8 GB of examples that are not needed

"""
_CONFIG = """\
Then write a file, say egoallo.toml (paths are relative to it):

  [egoallo]
  python = "egoallo/.venv/bin/python"
  folder = "egoallo"
  model = "{model}"
  # command = ["{{python}}", "3_aria_inference.py", "--traj-root", "{{mps}}", "--traj-length", "{{frames}}",
  #            "--guidance-mode", "{{guidance}}", "--smplh-npz-path", "{{model}}"]      # this is the default
  # needs = ["vrs", "points"]                   # what of a recording the command cannot do without
  # timeout_minutes = 120                       # of one recording
  # environment = {{ CUDA_VISIBLE_DEVICES = "0" }}

and run:

  prbench poses egoallo --root {root} --config egoallo.toml

It prepares each recording (unpacks archives, turns ADT to Z up), runs the command, checks what comes out and moves it
to {target}. The same command resumes.

By hand instead: `prbench poses egoallo --root {root} --prepare` writes the prepared folders, then for each

  python 3_aria_inference.py --traj-root {by_hand} --traj-length FRAMES --guidance-mode MODE

whose outputs then lie where prbench looks.
"""


class PosesConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The table ``[egoallo]`` of a config file."""

    python: str
    """Interpreter of the environment in which EgoAllo is installed."""
    folder: Path
    """EgoAllo's repository: the command runs there."""
    command: Annotated[tuple[str, ...], msgspec.Meta(min_length=1)] = _DEFAULT_COMMAND
    """Program and arguments, one text each; never a line for a shell."""
    model: Path | None = None
    """The SMPL-H model; found as the readers find it if None."""
    needs: frozenset[Need] = frozenset(("vrs", "points"))
    """Inputs that EgoAllo cannot do without; ``points`` tell it the floor, ``vrs`` the calibration."""
    timeout_minutes: Annotated[float, msgspec.Meta(gt=0)] = 120.0
    """Longest time for one recording."""
    environment: dict[str, str] = {}
    """Further environment variables, for example ``CUDA_VISIBLE_DEVICES``."""

    def command_line(self, values: Mapping[str, str]) -> list[str]:
        """The command with its placeholders filled; texts stay single arguments whatever they hold."""
        # Filled per argument and never joined: a path with spaces or quotes stays one argument, and no shell sees it.
        filled = {"python": self.python} | dict(values)
        return [_PLACEHOLDER.sub(lambda match: filled[match[1]], text) for text in self.command]


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    egoallo: PosesConfig


@foreign_input()
def read_config(path: Path) -> PosesConfig:
    """Read a config file; relative paths in it are relative to its folder.

    Raises:
        InputFileError: if it is missing, no TOML, lacks a key or holds an unknown one, or its command has an unknown
            placeholder.
    """
    try:
        content = tomllib.loads(read_text(path, encoding="utf-8", largest=HARMLESS_SIZE))
        config = msgspec.convert(content, _File, dec_hook=_path).egoallo
    except FileNotFoundError as error:
        raise InputFileError(
            path,
            "",
            expected="a config file",
            found="no such file",
            remedy="`prbench poses egoallo --root DIR` without --config prints one to start from.",
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, msgspec.ValidationError) as error:
        raise InputFileError(
            path,
            "",
            expected="a table [egoallo] with python and folder, and optionally command, model, needs, timeout_minutes"
            " and environment",
            found=str(error),
            remedy="`prbench poses egoallo --root DIR` without --config prints one to start from.",
        ) from error
    unknown = [name for text in config.command for name in _PLACEHOLDER.findall(text) if name not in _PLACEHOLDERS]
    if unknown:
        raise InputFileError(
            path,
            "egoallo.command",
            expected=f"the placeholders {', '.join(f'{{{name}}}' for name in _PLACEHOLDERS)}",
            found=f"{{{unknown[0]}}}",
        )
    base = path.expanduser().absolute().parent
    model = None if config.model is None else base / config.model.expanduser()
    # A bare name such as python3.12 is found on PATH; anything with a separator is a path relative to the file.
    looks_like_path = "/" in config.python or "\\" in config.python
    python = str(base / Path(config.python).expanduser()) if looks_like_path else config.python
    return msgspec.structs.replace(config, python=python, folder=base / config.folder.expanduser(), model=model)


def _path(kind: type, value: object) -> object:
    if kind is Path and isinstance(value, str):
        return Path(value)
    raise NotImplementedError(f"values of the type {kind}")


def instructions(root: Path, lacking: Sequence[PoseState]) -> str:
    """Commands that lead to the bodies which are lacking."""
    example = lacking[0].target if lacking else root / ego.POSES_FOLDER / "RECORDING" / ego.OUTPUT_FOLDER
    return (
        _INSTALL
        + HOW_TO_GET
        + "\n\n"
        + _CONFIG.format(root=root, target=example, by_hand=example.parent, model=ego.MODEL_FILE)
    )


_GRACE = 5.0  # seconds between asking a program to end and ending it
_TAIL_BYTES = 4096
_TAIL_LINES = 3
_UNPRINTABLE = re.compile(r"[^\x20-\x7e]+")


def run_program(
    command: Sequence[str], *, folder: Path, environment: Mapping[str, str], log: Path, timeout: float
) -> str:
    """Run a program without a shell, everything it prints into a log, and end it when its time is up.

    Args:
        command: Program and arguments.
        folder: Where it runs.
        environment: Added to this process's environment.
        log: Overwritten.
        timeout: Seconds.

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
                list(command),
                cwd=folder,
                env={**os.environ, **environment},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                # A group of its own, so that its children can be ended with it.
                start_new_session=os.name == "posix",
            )
        except OSError as error:
            raise UsageError(
                f"cannot start {command[0]} in {folder}: {error.strerror}."
                " Check python, folder and command in the config."
            ) from error
        try:
            code = process.wait(timeout)
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
    with open(log, "rb") as file:
        file.seek(0, 2)
        file.seek(max(file.tell() - _TAIL_BYTES, 0))
        text = file.read().decode("utf-8", errors="replace")
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
