"""Run the tests of one package on a copy of the tree that holds one mutant."""

from __future__ import annotations

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tests.mutation.mutants import Mutant, mutated_source

_NOT_COPIED = shutil.ignore_patterns(".git", "__pycache__", ".pytest_cache", "*.egg-info", "node_modules", "build")
_FOLDERS = {
    "prbench_adapters": "adapters",
    "prbench_benchmarks": "benchmarks",
    "prbench_data_manifests": "data_manifests",
}
_FAILED = re.compile(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", re.MULTILINE)
_LONGEST_WAIT = 15
"""Seconds of the clock that a second of computing may take before a run is given up, on a machine that others use."""


@dataclass(frozen=True)
class Outcome:
    """What the tests said.

    Attributes:
        verdict: ``killed``, ``survived``, or ``timeout`` where the time was over before any test failed.
        test: First test that failed; empty if none did.
        seconds: Computing time, including that of subprocesses.
    """

    verdict: str
    test: str
    seconds: float


class MutatedCopy:
    """A copy of a checkout in which files are mutated and tests run; the checkout itself is only read."""

    def __init__(self, tree: Path, folder: Path, seconds: float) -> None:
        self._tree = folder / "tree"
        self._seconds = seconds
        self._sound: dict[str, bool] = {}
        self.options: tuple[str, ...] = ()  # more of pytest's
        shutil.copytree(tree, self._tree, ignore=_NOT_COPIED, symlinks=True)
        installed = folder / "installed"  # found before an editable installation of another tree
        installed.mkdir(parents=True)
        for name, source in _FOLDERS.items():
            (installed / name).symlink_to(self._tree / source)
        egg_info = [sys.executable, "setup.py", "-q", "egg_info", "--egg-base", str(installed)]
        subprocess.run(egg_info, cwd=self._tree, check=True)
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(self._tree), str(installed)]),
            "PRBENCH_CACHE": str(folder / "cache"),
            "TMPDIR": str(folder),
        }
        self._pytest("--collect-only", "-q", "-n", "0", "tests")  # compiles the modules outside anybody's time

    def judge(self, mutant: Mutant) -> Outcome:
        """Run the tests of the mutant's package until one fails.

        Args:
            mutant: Names module and package.

        Returns:
            The outcome; a test that also fails without the mistake raises.

        Raises:
            RuntimeError: if the test that failed is no good on the sound tree.
        """
        return self.judge_source(mutant.module, mutated_source(self._tree, mutant), self._tests(mutant))

    def judge_source(self, module: str, source: str, tests: list[Path]) -> Outcome:
        """Run tests until one fails while a module has another source; arguments and errors as for :meth:`judge`.

        Args:
            module: File of the module, relative to the tree.
            source: Its source with the mistake.
            tests: Files of tests, relative to the tree, in the order in which they run.
        """
        path = self._tree / module
        sound = path.read_text(encoding="utf-8")
        self._write(path, source)
        try:
            outcome = self._run([str(file) for file in tests])
        finally:
            self._write(path, sound)
        if outcome.test and not self._passes(outcome.test):
            raise RuntimeError(f"{outcome.test} fails on the sound tree")
        return outcome

    def _tests(self, mutant: Mutant) -> list[Path]:
        tests = self._tree / "tests"
        folder = tests / mutant.package
        files = list(folder.rglob("test_*.py")) if folder.is_dir() else [tests / f"test_{mutant.package}.py"]
        module = mutant.module.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        parent, _, name = module.rpartition(".")
        imports = re.compile(rf"{re.escape(module)}\b|from {re.escape(parent)} import [^\n]*\b{name}\b")

        def remoteness(file: Path) -> tuple[int, str]:
            relative = file.relative_to(self._tree).as_posix()
            if file.stem == f"test_{name}":
                return 0, relative
            if imports.search(file.read_text(encoding="utf-8")):
                return 1, relative
            same_folder = file.parent.name in module.split(".")[2:]
            return (2 if same_folder else 3), relative

        return [file.relative_to(self._tree) for file in sorted(files, key=remoteness)]

    def _passes(self, test: str) -> bool:
        if test not in self._sound:
            self._sound[test] = self._run([test]).verdict == "survived"
        return self._sound[test]

    def _run(self, tests: list[str]) -> Outcome:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        options = ["-n", "0", "-x", "-q", "-p", "no:cacheprovider", "-ra", *self.options]
        status, output = self._pytest(*options, *tests, limit=self._seconds)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        failed = _FAILED.search(output)
        if failed or status in (1, 2):
            return Outcome("killed", failed.group(1) if failed else tests[0], seconds)
        return Outcome("survived" if status == 0 else "timeout", "", seconds)

    def _pytest(self, *arguments: str, limit: float | None = None) -> tuple[int, str]:
        """Exit status and output of a call; processes that it leaves behind are ended."""
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *arguments],
            cwd=self._tree,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            preexec_fn=partial(_limit_computing, limit) if limit else None,
        )
        try:
            output, _ = process.communicate(timeout=limit * _LONGEST_WAIT if limit else None)
        except subprocess.TimeoutExpired:
            output = ""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        return process.wait(), output

    @staticmethod
    def _write(path: Path, source: str) -> None:
        path.write_text(source, encoding="utf-8")
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
            compiled.unlink()  # a mutant may have the size and the second of the sound module


def _limit_computing(seconds: float) -> None:
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
