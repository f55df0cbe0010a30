"""Keep an installed method, or a user's program, at a distance: what it is shown, and what is withheld."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import prbench
from prbench.engine.unseen import hide_process
from prbench.errors import UsageError
from prbench.files.bounded import read_text
from prbench.harness.methods import installed, process, programs, unprivileged
from prbench.limits import HARMLESS_SIZE
from prbench.text import CLIP_VARIABLE, DISTILBERT_VARIABLE

BUBBLEWRAP = "bubblewrap"
HOME = "/tmp/home"  # inside the fence, where /tmp is empty and its own
_WORK = "/tmp/work"
_NAMESPACES = ("--unshare-all", "--die-with-parent", "--new-session", "--cap-drop", "ALL")
_DEVICES = ("nvidia*", "dri", "kfd", "dxg")
_PROBE_TIMEOUT = 10.0  # seconds; it takes 10 ms
_SYSTEM_FOLDERS = tuple(
    map(Path, ("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/libx32", "/etc", "/nix/store"))
)


@dataclass(frozen=True)
class Shown:
    """A file or folder that a method needs.

    Attributes:
        essential: Shown even inside a hidden folder, such as the weights that the user named.
    """

    path: Path
    writable: bool = False
    essential: bool = False


@dataclass(frozen=True)
class Mount:
    """``source`` appears at ``place``; without a source nothing is to be seen there.

    Attributes:
        file: A file is to be hidden.
    """

    source: Path | None
    place: Path
    writable: bool = False
    file: bool = False


def arrange(shown: Sequence[Shown], hidden: Sequence[Path]) -> list[Mount]:
    """Return mounts and masks in the order in which they have to be made: outer ones before inner ones.

    Links are followed once, here: what a shown path leads to appears under its own name too, and a hidden folder is
    covered wherever it would appear. Hidden folders that do not exist yet are made where they have to be covered.
    """
    secrets = [path.resolve() for path in dict.fromkeys(hidden)]
    system = [Mount(folder.resolve(), folder) for folder in _SYSTEM_FOLDERS if folder.is_dir()]
    wanted = []
    for item in shown:
        source = item.path.resolve()
        if source.exists() and (item.essential or not _inside_any(source, secrets)):
            wanted += [Mount(source, place, item.writable) for place in dict.fromkeys((source, item.path))]
    # What an outer mount shows already is left out; not what lies in a place that is going to be covered.
    kept = list(system)
    for mount in sorted(dict.fromkeys(wanted), key=lambda one: (len(one.place.parts), not one.writable)):
        repeated = any(mount.place.is_relative_to(outer.place) for outer in kept)
        if not repeated or mount.writable or _inside_any(mount.source or mount.place, secrets):
            kept.append(mount)
    mounts = [mount for mount in kept if mount.place not in _SYSTEM_FOLDERS]
    masks = []
    for mount in [*mounts, *system]:
        assert mount.source is not None
        for secret in secrets:
            if mount.source.is_dir() and secret.is_relative_to(mount.source):
                with contextlib.suppress(OSError):  # one that cannot be made now will not appear later either
                    if not secret.exists():
                        secret.mkdir(parents=True)
                    masks.append(Mount(None, mount.place / secret.relative_to(mount.source), file=secret.is_file()))
    # A mask comes after the mount of the same depth, or the mount would uncover it.
    return sorted([*mounts, *dict.fromkeys(masks)], key=lambda step: (len(step.place.parts), step.source is None))


def _inside_any(path: Path, folders: Sequence[Path]) -> bool:
    return any(path.is_relative_to(folder) for folder in folders)


@dataclass(frozen=True)
class Fence:
    """The isolation that works on this machine.

    Attributes:
        program: Path of bubblewrap; None where the file system cannot be withheld.
        reason: Reason why it cannot.
    """

    program: str | None
    reason: str = ""

    @property
    def notice(self) -> str:
        """Message that the user gets before a run."""
        if self.program is not None:
            return "isolated by bubblewrap: paths, objects, environment, network and the file system are withheld."
        visible = f"THE FILE SYSTEM IS NOT WITHHELD ({self.reason}): a method that looks for the table can read it."
        return f"isolated in a process of its own: paths, objects and environment are withheld. {visible}"


@lru_cache(maxsize=1)
def available_fence() -> Fence:
    """Return the best fence that works here; tried once a process."""
    program = shutil.which("bwrap")
    if program is None:
        return Fence(None, "bubblewrap is not installed")
    trial = [program, *_NAMESPACES, "--ro-bind", "/", "/", "--proc", "/proc", "--dev", "/dev", "true"]
    try:
        done = subprocess.run(trial, stdin=subprocess.DEVNULL, capture_output=True, timeout=_PROBE_TIMEOUT, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return Fence(None, f"bubblewrap does not work here: {error}")
    if done.returncode != 0:
        told = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        return Fence(None, f"bubblewrap does not work here: {told[0]}")
    return Fence(program)


def require_fence(methods: Iterable[str]) -> None:
    """Refuse methods from which this machine cannot withhold the file system.

    Args:
        methods: Names, commands or TOML files; one that runs in a container needs no other fence.

    Raises:
        UsageError: naming the method, what was found and what to install.
    """
    fence = available_fence()
    for method in methods:
        if fence.program is None and not programs.runs_in_container(method):
            problem = f"'{installed.short_name(method)}' could read all your files: {fence.reason}"
            linux = "on Linux `apt install bubblewrap` or `dnf install bubblewrap`; it needs user namespaces"
            remedy = f"Install bubblewrap ({linux}), or run the method in a container (docs/environments.md)."
            raise UsageError(f"--require-fence: {problem}. {remedy}")


def bubblewrap_words(
    program: str, *, shown: Sequence[Shown], hidden: Sequence[Path], directory: Path | None
) -> tuple[str, ...]:
    """Return the words before a command that let it see the system, what it is shown, and nothing else.

    Args:
        program: Path of bubblewrap.
        shown: Files and folders beside the system's.
        hidden: Folders that stay invisible even inside what is shown.
        directory: Folder in which the command starts; None for an empty one.
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
        if step.source is not None:
            words += ["--bind" if step.writable else "--ro-bind", str(step.source), str(step.place)]
        else:
            words += ["--ro-bind", "/dev/null", str(step.place)] if step.file else ["--tmpfs", str(step.place)]
    return (*words, "--chdir", str(directory or _WORK), "--")


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
    found = [Path(text) for text in (*prefixes, *import_path())]
    for name in (prbench.__name__, "prbench_data_manifests", "prbench_benchmarks", target.partition(":")[0]):
        # Whichever import hook finds the package.
        with contextlib.suppress(ImportError, ValueError):
            spec = importlib.util.find_spec(name.partition(".")[0])
            if spec is not None:
                found += [Path(folder) for folder in spec.submodule_search_locations or ()]
                if spec.origin and not spec.submodule_search_locations and Path(spec.origin).is_file():
                    found.append(Path(spec.origin))
    # Of packages that setuptools installed in place: their finders map names to folders.
    for finder in sys.meta_path:
        mapping = getattr(sys.modules.get(getattr(finder, "__module__", "")), "MAPPING", None)
        if isinstance(mapping, dict):
            found += [Path(folder) for folder in mapping.values() if Path(folder).exists()]
    return tuple(dict.fromkeys([*found, *executable_folders(Path(sys.executable))]))


def executable_folders(program: Path) -> tuple[Path, ...]:
    """Return a program's files outside the system's folders: itself, and the installation that it is part of."""
    actual = program.resolve()
    folders = [program.parent, actual.parent]
    # The folder of the interpreter that a virtual environment was made with.
    settings = program.parent.parent / "pyvenv.cfg"
    for line in read_text(settings, largest=HARMLESS_SIZE).splitlines() if settings.is_file() else ():
        key, _, value = line.partition("=")
        if key.strip() == "home":
            folders.append(Path(value.strip()))
    home = Path.home()
    found = [program, actual]
    for folder in folders:
        # The user's home, its .local and what lies above are too broad to show.
        is_personal = folder.parent == home / ".local" or home.is_relative_to(folder.parent)
        if folder.name in ("bin", "condabin", "Scripts", "shims") and not is_personal:
            found.append(folder.parent)
    return tuple(dict.fromkeys(found))


def fenced(program: process.Program, *, weights: Path | None, hidden: tuple[Path, ...]) -> process.Program:
    """Put a user's program behind the best fence that works here, its own folder read-only.

    Raises:
        UsageError: if its folder is one that has to be withheld.
    """
    environment = dict(program.environment)
    directory = program.directory
    if directory is not None and any(directory.resolve().is_relative_to(folder.resolve()) for folder in hidden):
        raise UsageError(f"--isolate: the program starts in {directory}, which is withheld. Start it elsewhere.")
    paths = [*program.readable, *executable_folders(Path(program.words[0])), *readable_folders(environment)]
    shown = [Shown(path) for path in dict.fromkeys(paths)]
    if weights is not None:
        shown.append(Shown(weights.absolute(), essential=True))
    return behind_fence(program, shown, hidden)


def behind_fence(program: process.Program, shown: Iterable[Shown], hidden: tuple[Path, ...]) -> process.Program:
    """Put a program behind the best fence that works here, which shows it these files and folders alone."""
    hide_process()
    fence = available_fence()
    if fence.program is None:
        before = (sys.executable, "-I", "-S", unprivileged.__file__) if sys.platform == "linux" else ()
        return replace(program, words=before + program.words, fence="process")
    before = bubblewrap_words(fence.program, shown=list(shown), hidden=hidden, directory=program.directory)
    # Add the variables behind bubblewrap: an empty home, an empty temporary folder, no network to ask for models.
    environment = {**dict(program.environment), "HOME": HOME, "TMPDIR": "/tmp", "HF_HUB_OFFLINE": "1"}
    return replace(
        program, words=before + program.words, environment=tuple(sorted(environment.items())), fence=BUBBLEWRAP
    )
