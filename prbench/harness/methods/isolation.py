"""Keep an installed method, or a user's program, at a distance: what it is shown, and what is withheld."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import prbench
from prbench.errors import UsageError
from prbench.harness.methods.process import Program, users_environment
from prbench.text.pretrained import CLIP_VARIABLE, DISTILBERT_VARIABLE

_PROCESS = "process"
BUBBLEWRAP = "bubblewrap"
HOME = "/tmp/home"  # inside the fence, where /tmp is empty and its own
_WORK = "/tmp/work"
_NAMESPACES = ("--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL")
_DEVICES = ("nvidia*", "dri", "kfd", "dxg")
_PROBE_TIMEOUT = 10.0  # seconds; it takes 10 ms
_SYSTEM_FOLDERS = tuple(
    Path(name) for name in ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/etc", "/nix/store")
)


@dataclass(frozen=True)
class Shown:
    """A file or folder that a method needs."""

    path: Path
    writable: bool = False
    essential: bool = False
    """Shown even inside a hidden folder, such as the weights that the user named."""


@dataclass(frozen=True)
class Mount:
    """``source`` appears at ``place``."""

    source: Path
    place: Path
    writable: bool = False


@dataclass(frozen=True)
class Mask:
    """Nothing is to be seen at ``place``."""

    place: Path
    file: bool = False


def arrange(shown: Sequence[Shown], hidden: Sequence[Path]) -> list[Mount | Mask]:
    """Return mounts and masks in the order in which they have to be made: outer ones before inner ones.

    Links are followed once, here: what a shown path leads to appears under its own name too, and a hidden folder is
    covered wherever it would appear. Hidden folders that do not exist yet are made where they have to be covered.
    """
    secrets = [path.resolve() for path in dict.fromkeys(hidden)]
    mounts = _without_nested(list(_mounts(shown, secrets)), secrets)
    masks = list(dict.fromkeys(_masks([*mounts, *_of_system()], secrets)))
    # A mask comes after the mount of the same depth, or the mount would uncover it.
    return sorted([*mounts, *masks], key=lambda step: (len(step.place.parts), isinstance(step, Mask)))


@dataclass(frozen=True)
class Fence:
    """The kind of isolation that works on this machine."""

    kind: str
    """``bubblewrap``, or ``process`` where the file system cannot be withheld."""
    program: str | None
    """Path of bubblewrap."""
    reason: str
    """Reason why the file system cannot be withheld; empty if it can."""

    @property
    def notice(self) -> str:
        """Message that the user gets before a run."""
        if self.kind == BUBBLEWRAP:
            return "isolated by bubblewrap: paths, objects, environment, network and the file system are withheld."
        return (
            "isolated in a process of its own: paths, objects and environment are withheld."
            f" THE FILE SYSTEM IS NOT WITHHELD ({self.reason}): a method that looks for the table can read it."
        )


@lru_cache(maxsize=1)
def available_fence() -> Fence:
    """Return the best fence that works here; tried once a process."""
    program = shutil.which("bwrap")
    if program is None:
        return Fence(_PROCESS, None, "bubblewrap is not installed")
    trial = [program, *_NAMESPACES, "--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev", "true"]
    try:
        done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PROBE_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Fence(_PROCESS, None, f"bubblewrap does not work here: {error}")
    if done.returncode != 0:
        told = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return Fence(_PROCESS, None, f"bubblewrap does not work here: {told[0]}")
    return Fence(BUBBLEWRAP, program, "")


def bubblewrap_words(
    program: str, *, shown: Sequence[Shown], hidden: Sequence[Path], directory: Path | None
) -> tuple[str, ...]:
    """Return the words before a command that let it see the system, what it is shown, and nothing else.

    Args:
        program: Path of bubblewrap.
        shown: Files and folders beside the system's.
        hidden: Folders that stay invisible even inside what is shown.
        directory: Where the command starts; None for an empty folder.
    """
    words = [program, *_NAMESPACES]
    for folder in _SYSTEM_FOLDERS:
        if folder.is_symlink():
            words += ["--symlink", str(folder.readlink()), str(folder)]
        elif folder.is_dir():
            words += ["--ro-bind", str(folder), str(folder)]
    words += ["--proc", "/proc", "--dev", "/dev", "--ro-bind", "/sys", "/sys", "--tmpfs", "/tmp"]
    # /dev is empty inside, and a GPU is reached through these files.
    for device in sorted(path for pattern in _DEVICES for path in Path("/dev").glob(pattern)):
        words += ["--dev-bind-try", str(device), str(device)]
    words += ["--dir", HOME, "--dir", _WORK]
    for step in arrange(shown, hidden):
        words += _step_words(step)
    return (*words, "--chdir", str(directory or _WORK), "--")


def _mounts(shown: Sequence[Shown], secrets: Sequence[Path]) -> Iterator[Mount]:
    for item in shown:
        source = item.path.resolve()
        if not source.exists() or (not item.essential and _inside_any(source, secrets)):
            continue
        yield Mount(source, source, item.writable)
        if item.path != source:
            yield Mount(source, item.path, item.writable)


def _without_nested(mounts: list[Mount], secrets: Sequence[Path]) -> list[Mount]:
    """Leave out what an outer mount shows already; not what lies in a place that is going to be covered."""
    kept = _of_system()
    for mount in sorted(dict.fromkeys(mounts), key=lambda one: (len(one.place.parts), not one.writable)):
        repeated = any(mount.place.is_relative_to(outer.place) for outer in kept)
        if not repeated or mount.writable or _inside_any(mount.source, secrets):
            kept.append(mount)
    return [mount for mount in kept if mount.place not in _SYSTEM_FOLDERS]


def _masks(mounts: Sequence[Mount], secrets: Sequence[Path]) -> Iterator[Mask]:
    for mount in mounts:
        for secret in secrets:
            if mount.source.is_dir() and secret.is_relative_to(mount.source) and _made(secret):
                yield Mask(mount.place / secret.relative_to(mount.source), secret.is_file())


def _made(folder: Path) -> bool:
    """Make a folder that is to be covered; one that cannot be made now will not appear later either."""
    try:
        if not folder.exists():
            folder.mkdir(parents=True)
    except OSError:
        return False
    return True


def _of_system() -> list[Mount]:
    return [Mount(folder.resolve(), folder) for folder in _SYSTEM_FOLDERS if folder.is_dir()]


def _inside_any(path: Path, folders: Sequence[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


def _step_words(step: Mount | Mask) -> list[str]:
    if isinstance(step, Mask):
        return ["--ro-bind", "/dev/null", str(step.place)] if step.file else ["--tmpfs", str(step.place)]
    return ["--bind" if step.writable else "--ro-bind", str(step.source), str(step.place)]


_ALLOWED = frozenset(
    {
        "PATH", "LANG", "LANGUAGE", "TZ", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "TMPDIR",
        "PYTHONHASHSEED", "PYTHONUTF8", "PYTHONIOENCODING", "PYTHONWARNINGS",
        "HF_HOME", "HF_HUB_CACHE", "HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "TORCH_HOME",
        # Windows: programs do not start, or find no folder of their own, without these.
        "SYSTEMROOT", "SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT", "TEMP", "TMP", "USERPROFILE",
        "NUMBER_OF_PROCESSORS", "PROCESSOR_ARCHITECTURE",
    }
)  # fmt: skip
_ALLOWED_BEGINNINGS = (
    "LC_", "CUDA_", "CUDNN_", "CUBLAS_", "NVIDIA_", "PYTORCH_", "OMP_", "KMP_", "GOMP_", "MKL_", "OPENBLAS_",
    "NUMEXPR_", "VECLIB_", "HIP_", "HSA_", "ROCR_",
)  # fmt: skip
_TEXT_ENCODERS = (DISTILBERT_VARIABLE, CLIP_VARIABLE)
_MODEL_CACHES = {"HF_HOME": "huggingface", "TORCH_HOME": "torch"}


def isolated_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the part of the user's environment that an isolated method gets.

    ``HOME`` is not among it, nor is any variable of the harness. Where models are cached is named instead.

    Args:
        environment: Environment variables of the user.
    """
    kept = {
        name: value
        for name, value in environment.items()
        if name.upper() in _ALLOWED or name.upper().startswith(_ALLOWED_BEGINNINGS)
    }
    for variable, folder in _MODEL_CACHES.items():
        default = Path(environment.get("XDG_CACHE_HOME") or Path.home() / ".cache") / folder
        if variable not in kept and default.is_dir():
            kept[variable] = str(default)
    return kept


def text_encoder(environment: Mapping[str, str]) -> dict[str, str]:
    """Return the only variables of prbench that installed methods need: paths of text encoders."""
    return {name: environment[name] for name in _TEXT_ENCODERS if environment.get(name)}


def readable_folders(environment: Mapping[str, str]) -> tuple[Path, ...]:
    """Return the folders that the variables of an isolated environment lead to: models and libraries."""
    named = [environment.get(name) for name in (*_MODEL_CACHES, "HF_HUB_CACHE", *_TEXT_ENCODERS)]
    libraries = environment.get("LD_LIBRARY_PATH", "").split(os.pathsep)
    return tuple(Path(text).absolute() for text in [*named, *libraries] if text and Path(text).exists())


def import_path() -> tuple[str, ...]:
    """Return the folders and archives of ``sys.path`` that exist."""
    return tuple(dict.fromkeys(str(Path(entry).absolute()) for entry in sys.path if entry and Path(entry).exists()))


def python_folders(target: str) -> tuple[Path, ...]:
    """Return the folders that this interpreter needs to import a module.

    Args:
        target: ``module:callable`` of an entry point; nothing of it is imported.
    """
    prefixes = (sys.prefix, sys.base_prefix, sys.exec_prefix, sys.base_exec_prefix)
    packages = (prbench.__name__, "prbench_data_manifests", "prbench_benchmarks", target.partition(":")[0])
    found = [Path(text) for text in (*prefixes, *import_path())]
    found += [folder for name in packages for folder in _package_folders(name.partition(".")[0])]
    return tuple(dict.fromkeys([*found, *_editable_folders(), *executable_folders(Path(sys.executable))]))


def executable_folders(program: Path) -> tuple[Path, ...]:
    """Return a program's files outside the system's folders: itself, and the installation that it is part of."""
    actual = program.resolve()
    found = [program, actual]
    for folder in (program.parent, actual.parent, *_virtual_environment_home(program)):
        if folder.name in ("bin", "condabin", "Scripts", "shims") and not _is_personal(folder.parent):
            found.append(folder.parent)
    return tuple(dict.fromkeys(found))


def _virtual_environment_home(program: Path) -> Iterator[Path]:
    """Yield the folder of the interpreter that a virtual environment was made with."""
    settings = program.parent.parent / "pyvenv.cfg"
    if settings.is_file():
        for line in settings.read_text(encoding="utf-8").splitlines():
            key, _, value = line.partition("=")
            if key.strip() == "home":
                yield Path(value.strip())


def _is_personal(folder: Path) -> bool:
    """Return True for a folder too broad to show: the user's home, its ``.local``, or above."""
    home = Path.home()
    return folder == home / ".local" or home.is_relative_to(folder)


def _package_folders(name: str) -> Iterator[Path]:
    """Yield the folders of a top-level package, whichever import hook finds it."""
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):
        return
    if spec is None:
        return
    yield from (Path(folder) for folder in spec.submodule_search_locations or ())
    if spec.origin and not spec.submodule_search_locations and Path(spec.origin).is_file():
        yield Path(spec.origin)


def _editable_folders() -> Iterator[Path]:
    """Yield folders of packages that setuptools installed in place: their finders map names to folders."""
    for finder in sys.meta_path:
        module = sys.modules.get(getattr(finder, "__module__", ""))
        mapping = getattr(module, "MAPPING", None)
        if isinstance(mapping, dict):
            yield from (Path(folder) for folder in mapping.values() if Path(folder).exists())


_FIT_TIMEOUT = 7 * 24 * 3600.0  # seconds: fitting takes as long as it takes, as it does in this process
_WORKER = "prbench.harness.methods.worker"


@dataclass(frozen=True)
class Fit:
    """Folders of a fit: training rows, and the result."""

    train: Path
    """Folder of a copy of the training rows."""
    folder: Path


def worker_program(
    name: str,
    target: str,
    *,
    weights: Path | None,
    options: Iterable[tuple[str, str]],
    hidden: tuple[Path, ...],
    fit: Fit | None = None,
    timeout: float | None = None,
    benchmark: str,
) -> Program:
    """Return the worker that runs an installed method at a distance.

    Args:
        name: Name of the method.
        target: ``module:callable`` of its entry point.
        weights: A file or folder, or a name that the method knows.
        options: For the method; files that their values name by absolute paths are shown to it.
        hidden: Folders to withhold where that is possible.
        fit: For a method that is fitted by the run.
        timeout: Seconds for a batch.
        benchmark: Name of its benchmark.
    """
    environment = isolated_environment(users_environment()) | text_encoder(os.environ)
    # The worker finds prbench where this process found it, installed or not; it drops the variable again.
    environment["PYTHONPATH"] = os.pathsep.join(import_path())
    words = [sys.executable, "-P", "-m", _WORKER, name, "--benchmark", benchmark]
    shown = [Shown(path) for path in (*python_folders(target), *readable_folders(environment))]
    shown += [Shown(Path(value)) for _, value in options if Path(value).is_absolute()]
    if weights is not None:
        shown.append(Shown(weights.absolute(), essential=True))
    program = Program(name, (), None, tuple(sorted(environment.items())))
    if timeout is not None:
        program = replace(program, batch_timeout=timeout)
    if fit is not None:
        fit.folder.mkdir(parents=True, exist_ok=True)
        words += ["--train", str(fit.train), "--fit", str(fit.folder)]
        shown += [Shown(fit.train, essential=True), Shown(fit.folder, writable=True, essential=True)]
        program = replace(program, start_timeout=_FIT_TIMEOUT)
    return _behind_fence(replace(program, words=tuple(words)), shown, hidden)


def fenced(program: Program, *, readable: Iterable[Path], weights: Path | None, hidden: tuple[Path, ...]) -> Program:
    """Put a user's program behind the best fence that works here, its own folder read-only.

    Raises:
        UsageError: if its folder is one that has to be withheld.
    """
    environment = dict(program.environment)
    directory = program.directory
    if directory is not None and any(directory.resolve().is_relative_to(folder.resolve()) for folder in hidden):
        raise UsageError(f"--isolate: the program starts in {directory}, which is withheld. Start it elsewhere.")
    paths = [*readable, *executable_folders(Path(program.words[0])), *readable_folders(environment)]
    shown = [Shown(path) for path in dict.fromkeys(paths)]
    if weights is not None:
        shown.append(Shown(weights.absolute(), essential=True))
    return _behind_fence(program, shown, hidden)


def _behind_fence(program: Program, shown: Iterable[Shown], hidden: tuple[Path, ...]) -> Program:
    fence = available_fence()
    if fence.program is None:
        return replace(program, fence=fence.kind)
    before = bubblewrap_words(fence.program, shown=list(shown), hidden=hidden, directory=program.directory)
    # Add the variables behind bubblewrap: an empty home, an empty temporary folder, no network to ask for models.
    environment = {**dict(program.environment), "HOME": HOME, "TMPDIR": "/tmp", "HF_HUB_OFFLINE": "1"}
    return replace(
        program, words=before + program.words, environment=tuple(sorted(environment.items())), fence=BUBBLEWRAP
    )
