"""``import prbench`` offers names lazily and typed, and loads nothing heavy."""

from __future__ import annotations

import ast
import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

import prbench
import prbench.api

ROOT = Path(__file__).parents[2]
STUB = ROOT / "prbench" / "__init__.pyi"
HEAVY = {"numpy", "torch", "pandas", "pyarrow", "scipy", "matplotlib", "jaxtyping", "rich", "IPython"}


def _modules_after(code: str) -> set[str]:
    script = f"{code}\nimport sys\nprint('MODULES', *sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in done.stdout.split("MODULES", 1)[1].split()}


@pytest.mark.parametrize(
    ("used", "heavy"),
    [
        ("dir(prbench); hasattr(prbench, 'nothing'); prbench.__version__", HEAVY),
        ("prbench.open_table; prbench.measure; prbench.run", {"torch", "matplotlib", "pandas", "IPython"}),
    ],
)
def test_what_is_used_loads_nothing_heavier(used, heavy):
    assert _modules_after(f"import prbench; {used}") & heavy == set()


def test_every_name_is_there_and_documented():
    for name in set(prbench.__all__) - {"__version__"}:
        value = getattr(prbench, name)
        assert value is getattr(prbench.api, name)
        assert name in dir(prbench)
        assert inspect.getdoc(value), name


def test_star_import_and_stub_offer_the_same_names():
    stub = ast.parse(STUB.read_text(encoding="utf-8"))
    imported = {alias.asname for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    declared = {node.target.id for node in stub.body if isinstance(node, ast.AnnAssign)}  # type: ignore[union-attr]
    assert imported | declared == set(prbench.__all__)
    assert all(hasattr(prbench.api, name) for name in imported)


@pytest.mark.parametrize(("typed", "meant"), [("opn_table", "open_table"), ("embedded_table", "embedded_tables")])
def test_misspelt_names_are_answered_with_the_nearest(typed, meant):
    with pytest.raises(AttributeError, match=f"has no attribute '{typed}'. Did you mean '{meant}'"):
        getattr(prbench, typed)


def _public_members() -> list[tuple[str, object]]:
    members: list[tuple[str, object]] = []
    for name in sorted(set(prbench.__all__) - {"__version__"}):
        value = getattr(prbench.api, name)
        if not value.__module__.startswith("prbench.api"):
            continue
        members.append((name, value))
        if inspect.isclass(value):
            for attribute, member in vars(value).items():
                if not attribute.startswith("_") and (inspect.isfunction(member) or hasattr(member, "__doc__")):
                    members.append((f"{name}.{attribute}", getattr(member, "fget", None) or member))
    return members


def test_docstrings_name_every_argument():
    for name, member in _public_members():
        if inspect.isfunction(member) or inspect.isclass(member):
            text = inspect.getdoc(member)
            assert text, name
            arguments = inspect.signature(member).parameters if inspect.isfunction(member) else ()
            assert [each for each in arguments if each != "self" and f"{each}:" not in text] == [], name


USER_SCRIPT = """
from pathlib import Path
import prbench

table = prbench.open_table(Path("tables/adt"))
reveal_type(table)
reveal_type(table[0].joints)
reveal_type(prbench.run("static", data=table))
reveal_type(prbench.score({"a": table[0].joints}, "tables/adt").to_pandas())
reveal_type(prbench.compare("a", Path("b")).summary)
reveal_type([event.outcome for event in table.events])
reveal_type(table[0].head)
reveal_type(prbench.Joint.LEFT_WRIST)
prbench.run("static", conditon="none")
prbench.opn_table("x")
"""


@pytest.mark.slow
def test_type_checkers_know_names_arguments_and_results(tmp_path):
    pytest.importorskip("pyright", reason="pip install 'prbench[dev]'")
    script = tmp_path / "user.py"
    script.write_text(USER_SCRIPT)
    settings = {"typeCheckingMode": "standard", "reportMissingTypeStubs": False, "extraPaths": [str(ROOT)]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    command = [sys.executable, "-m", "pyright", "--pythonpath", sys.executable, "-p", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
    said = done.stdout
    for kind in ('"Table"', "ndarray", '"Run"', '"DataFrame"', '"str"', '"list[str]"', '"Head | None"'):
        assert f"is {kind}" in said or (kind == "ndarray" and kind in said), said
    assert 'No parameter named "conditon"' in said
    assert '"opn_table" is not a known attribute of module "prbench"' in said
    assert said.count(" - error: ") == 2, said
