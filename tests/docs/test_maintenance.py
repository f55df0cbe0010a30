"""What CONTRIBUTING, the release checklist and the templates say agrees with the files that they speak of."""

from __future__ import annotations

import re
import tomllib

import pytest

from prbench.harness.methods.messages import WIRE_VERSION
from prbench.harness.offline import FORMAT_VERSION
from prbench.harness.run_folder.scores import RUN_SCHEMA_VERSION
from prbench.sequences.corpus import CORPUS_SCHEMA_VERSION
from prbench.sequences.schema import SCHEMA_VERSION
from tests.docs.test_citations import ROOT, text_of

GITHUB = ROOT / ".github"
GUIDES = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PYPROJECT = tomllib.loads(text_of(ROOT / "pyproject.toml"))


def constraint(package: str) -> str:
    """The version of a package in constraints.txt."""
    return re.search(rf"^{package}==(\S+)", text_of(ROOT / "constraints.txt"), re.MULTILINE)[1]


def test_pre_commit_runs_the_ruff_of_the_constraints():
    yaml = pytest.importorskip("yaml")
    hooks = [
        hook for repo in yaml.safe_load(text_of(ROOT / ".pre-commit-config.yaml"))["repos"] for hook in repo["hooks"]
    ]
    assert {hook["id"] for hook in hooks} == {"ruff-check", "ruff-format"}
    assert {tuple(hook["additional_dependencies"]) for hook in hooks} == {(f"ruff=={constraint('ruff')}",)}


def test_templates_of_issues_ask_something():
    yaml = pytest.importorskip("yaml")
    templates = [path for path in (GITHUB / "ISSUE_TEMPLATE").glob("*.yml") if path.name != "config.yml"]
    assert len(templates) == 3
    for path in templates:
        form = yaml.safe_load(text_of(path))
        assert {"name", "description", "body"} <= set(form)
        asked = [part for part in form["body"] if part["type"] != "markdown"]
        assert asked
        assert all({"id", "attributes"} <= set(part) and part["attributes"]["label"] for part in asked)
        assert any(part.get("validations", {}).get("required") for part in asked)


def test_workflows_have_jobs_and_the_documentation_needs_no_secret():
    yaml = pytest.importorskip("yaml")
    for path in (GITHUB / "workflows").glob("*.yml"):
        assert yaml.safe_load(text_of(path))["jobs"]
    assert "secrets." not in text_of(GITHUB / "workflows" / "docs.yml")


def test_files_that_a_guide_tells_to_test_exist():
    named = {path for page in GUIDES for path in re.findall(r"pytest [^`\n#]*?(tests/[\w/]+(?:\.py)?)", text_of(page))}
    assert "tests/metrics/test_prime_success.py" in named
    own = {path for path in named if (ROOT / path).exists()}
    assert named - own <= {"tests/metrics/test_wrist_error.py"}  # which the reader of adding-a-metric.md writes


def test_extras_that_a_guide_installs_exist():
    groups = {names for page in GUIDES for names in re.findall(r"(?:prbench|\.)\[([a-z0-9,-]+)\]", text_of(page))}
    assert {name for names in groups for name in names.split(",")} <= set(PYPROJECT["project"]["optional-dependencies"])


def test_the_gate_installs_what_the_site_needs():
    gate = text_of(ROOT / ".ci" / "run")
    assert "mkdocs build --strict" in gate
    assert any("docs" in names.split(",") for names in re.findall(r"\.\[([a-z0-9,-]+)\]", gate))


def test_the_readme_holds_the_two_commands_that_the_gate_runs():
    lines = [line for line in text_of(ROOT / "README.md").splitlines() if line.startswith("pip install ")]
    assert [line for line in lines if "prbench run" in line][:1] == [lines[0]]
    assert any("pytest" in line for line in lines)


def test_citation_and_changelog_name_one_version():
    changelog = re.search(r"^## (\d+\.\d+\.\d+)", text_of(ROOT / "CHANGELOG.md"), re.MULTILINE)[1]
    assert re.search(r"^version: (\S+)", text_of(ROOT / "CITATION.cff"), re.MULTILINE)[1] == changelog


def test_the_page_on_versions_tells_todays():
    rows = re.findall(r"^\| ([a-z ]+) \| `(\d+)` \|", text_of(ROOT / "docs" / "versioning.md"), re.MULTILINE)
    protocol = tomllib.loads(text_of(ROOT / "benchmarks" / "prime_and_reach" / "protocol.toml"))
    assert {name: int(version) for name, version in rows} == {
        "protocol": protocol["version"],
        "sequence table": SCHEMA_VERSION,
        "corpus table": CORPUS_SCHEMA_VERSION,
        "run folder": RUN_SCHEMA_VERSION,
        "wire protocol": WIRE_VERSION,
        "conditions file": FORMAT_VERSION,
    }


def test_the_page_on_versions_names_the_groups_of_entry_points():
    page = text_of(ROOT / "docs" / "versioning.md")
    assert all(f"`{group}`" in page for group in PYPROJECT["project"]["entry-points"])


def test_the_six_metrics_are_defined_in_words():
    """Every metric of the study has a section with a formula, and a link to the definition that the code cites."""
    glossary = text_of(ROOT / "docs" / "glossary.md")
    metrics = text_of(ROOT / "docs" / "specification" / "metrics.md")
    titles = re.findall(r"^\| `\w+` \| ([^|]+) \|[^\n]*one of the six", metrics, re.MULTILINE)
    assert len(titles) == 6
    for title in titles:
        section = re.search(rf"^### {title}\n(.*?)(?=^##)", glossary, re.MULTILINE | re.DOTALL)[1]
        assert "```" in section
        assert f"(specification/metrics.md#{title.lower().replace(' ', '-')})" in section
