"""The methods under test, installed; and what the checks say about them, in this process."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from prbench.checking.conformance.cases import Cases, cases_of_table, synthetic_cases
from prbench.checking.conformance.checks import CHECKS
from prbench.checking.conformance.findings import Finding, examine
from prbench.checking.conformance.subject import Subject
from prbench.harness.methods.loading import forget_loaded_methods, method_spec
from prbench.harness.synthetic_table import build_synthetic_table
from tests.checking.conformance.methods_under_test import FAULTS
from tests.shared import made_once

MODULE = "prbench_methods_under_test"
BROKEN = {"cannotimport": "import no_such_package_of_prbench", "slowimport": "import time; time.sleep(1.1)"}
BROKEN["neverimported"] = "import time; time.sleep(500)"
EXTRA = ("takesanyoption", "takesanyweights", "misnamed")


@pytest.fixture(scope="package")  # tests elsewhere list what is installed
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder on ``sys.path`` with one package that offers all of them."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copy(Path(__file__).with_name("methods_under_test.py"), folder / f"{MODULE}.py")
    points = [f"{name} = {MODULE}:load_{name}" for name in (*FAULTS, *EXTRA)]
    for name, first_line in BROKEN.items():
        source = f"{first_line}\nfrom {MODULE} import load_as\nload = load_as('glide', name={name!r})\n"
        (folder / f"{MODULE}_{name}.py").write_text(source)
        points.append(f"{name} = {MODULE}_{name}:load")
    info = folder / f"{MODULE}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {MODULE}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[prbench.adapters]\n" + "\n".join(points) + "\n")
    sys.path.insert(0, str(folder))
    yield folder
    sys.path.remove(str(folder))


@pytest.fixture(scope="session")
def cases() -> Cases:
    """Three of the twelve synthetic test sequences."""
    return synthetic_cases(made_once("conformance-cases", synthetic_cases), limit=3)


@pytest.fixture(scope="session")
def people(cases: Cases) -> Cases:
    """All twelve."""
    return cases_of_table(cases.folder)


@pytest.fixture(scope="session")
def data() -> Path:
    """A dataset of a few test sequences, which a child opens faster than it makes them."""
    settings = {"n_events": 3, "noise": 0.0, "provocations": {}}
    return made_once("conformance-data", lambda folder: build_synthetic_table("adt", (1,), 2024, folder, **settings))


@pytest.fixture
def found(site: Path, cases: Cases, tmp_path: Path) -> Iterator[Callable[..., list[Finding]]]:
    """What the checks find about an installed method, here and not in a child."""

    def _found(name: str, **settings: object) -> list[Finding]:
        forget_loaded_methods()
        subject = Subject(method_spec(name, **settings), cases, tmp_path)
        return list(examine(subject, [one for one in CHECKS if not one.fresh]))

    yield _found
    forget_loaded_methods()
