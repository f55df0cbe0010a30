"""Every citation in code, configurations and documentation leads to a file and a heading that exist."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SPECIFICATION = ROOT / "docs" / "specification"
FOLDERS = ("prbench", "adapters", "data_manifests", "benchmarks", "docs", "tests")
KINDS = {".py", ".toml", ".md", ".template", ".csv", ".mjs"}
MADE_ELSEWHERE = {"node_modules", "__pycache__"}

# Numbers of the sections that the papers have.
PRIME_AND_REACH = re.compile(r"[1-6]|3\.[12]|4\.[12]|5\.[1-5]|[A-F]|B\.[1-5]|D\.[1-4]")
GAZEMODIFF = re.compile(r"[1-7]|3\.[1-4]|4\.[1-8]|5\.[12]")
NYMERIA = re.compile(r"[1-5]|3\.[1-4]|4\.[12]|[A-D]|B\.[1-3]|C\.[12]")
PAPERS = {"GazeMoDiff": GAZEMODIFF, "the Nymeria paper": NYMERIA}
"""Papers beside *Prime and Reach*, which is also called "the paper" and "the study"."""

TABLES = {"1", "2", "3", "4", *(f"S{number}" for number in range(1, 9))}
"""Tables of *Prime and Reach*."""
LAST_EQUATION = 8
"""Of *Prime and Reach*."""

_CITATION = re.compile(r"(?<![\w/.-])docs/(?P<page>[\w/-]+\.md)(?:#(?P<heading>[\w-]*))?")
_LINK = re.compile(r"\[[^\]\[]*\]\((?P<target>[^()\s]+)\)")
_NUMBER = r"(?:\d+(?:\.\d+)?|[A-F](?:\.\d+)?)(?![\w-])"
_SECTIONS = re.compile(rf"\bsections? (?P<numbers>{_NUMBER}(?:(?:, | and | to |, and ){_NUMBER})*)")
_TABLES = re.compile(
    r"(?:Prime and Reach\*?|paper|study),? tables? (?P<numbers>S?\d+(?:(?:, | and )S?\d+)*)", re.IGNORECASE
)
_EQUATIONS = re.compile(r"Prime and Reach\*?, (?:equations?|eq\.) (?P<numbers>\d+(?:(?:, | and | to )\d+)*)")
_STUDY = re.compile(r"(?:Prime and Reach|[Pp]aper|[Tt]he study|study)$")
GENERATED = {"tests/test_conformance.py", "tests/test_method.py"}
"""Files of the package that ``prbench adapters new`` writes."""

_PATH = re.compile(r"`(?P<path>(?:prbench|adapters|data_manifests|benchmarks|tests|docs)/[^`\s]*)`")

OLD_KINDS = (
    re.compile(r"(?<![\w/])(?:formats|methods)/[a-z0-9-]+\.md"),
    re.compile(r"\bthe design\b(?! effect)"),
    re.compile(r"\bdesign,? (?:section|§)"),
    re.compile(r"(?<!/)\bdesign\.md"),
    re.compile(r"§ ?\d"),
)
"""How pages were cited that a reader of the repository has not got."""


@cache
def text_of(path: Path) -> str:
    """The content of a file."""
    return path.read_text(encoding="utf-8")


def checked_files() -> list[Path]:
    """All files that cite something."""
    found = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "pyproject.toml")]
    for folder in FOLDERS:
        found += [path for path in sorted((ROOT / folder).rglob("*")) if path.suffix in KINDS and path.is_file()]
    return [path for path in found if not MADE_ELSEWHERE & set(path.parts) and path != Path(__file__)]


FILES = checked_files()
PAGES = [path for path in FILES if path.suffix == ".md"]


def name_of(path: Path) -> str:
    """The path below the repository's root."""
    return path.relative_to(ROOT).as_posix()


def found_in(files: list[Path], search: Callable[[str], list[str]]) -> dict[str, list[str]]:
    """What a search finds, by the name of the file; files without a finding are left out."""
    found = {name_of(path): search(text_of(path)) for path in files}
    return {name: texts for name, texts in found.items() if texts}


@cache
def headings(page: Path) -> frozenset[str]:
    """Anchors of a page's headings, as GitHub makes them."""
    seen: Counter[str] = Counter()
    anchors = []
    for line in without_code_blocks(text_of(page)).splitlines():
        match = re.fullmatch(r"#{1,6} (.+)", line)
        if match:
            anchor = anchor_of(match[1])
            anchors.append(f"{anchor}-{seen[anchor]}" if seen[anchor] else anchor)
            seen[anchor] += 1
    return frozenset(anchors)


def anchor_of(title: str) -> str:
    """The anchor of a heading: lower case, words joined by hyphens, no other signs."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title)
    return re.sub(r"[^\w\- ]", "", text.strip().lower()).replace(" ", "-")


def without_code_blocks(text: str) -> str:
    """A page without what stands between lines of three backticks."""
    return re.sub(r"^ *```.*?^ *```[^\n]*$", "", text, flags=re.MULTILINE | re.DOTALL)


def unresolved_citations(text: str) -> list[str]:
    """Citations of pages or headings that do not exist."""
    wrong = []
    for match in _CITATION.finditer(text):
        page = ROOT / "docs" / match["page"]
        if not page.is_file() or (match["heading"] is not None and match["heading"] not in headings(page)):
            wrong.append(match[0])
    return wrong


def old_citations(text: str) -> list[str]:
    """Text that looks like a citation of a page that is not in the repository."""
    return [match[0] for kind in OLD_KINDS for match in kind.finditer(text)]


def unresolved_links(page: Path, text: str) -> list[str]:
    """Links of a page to files or headings that do not exist."""
    wrong = []
    for match in _LINK.finditer(re.sub(r"`[^`\n]*`", "", without_code_blocks(text))):
        target, _, heading = match["target"].partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        path = (page.parent / target).resolve() if target else page
        if not path.exists() or (heading and (path.suffix != ".md" or heading not in headings(path))):
            wrong.append(match["target"])
    return wrong


def unknown_sections(text: str) -> list[str]:
    """Sections, tables and equations that the named paper has not got, or of which nobody says whose they are."""
    flat = re.sub(r"\n *#? *", " ", text)
    wrong = []
    for match in _SECTIONS.finditer(flat):
        before = re.sub(r"[*`\"“”=,(;: ]+$", "", flat[max(match.start() - 40, 0) : match.start()])
        numbers = re.findall(_NUMBER, match["numbers"])
        paper = next((known for name, known in PAPERS.items() if before.endswith(name)), None)
        if paper is None and (_STUDY.search(before) or _follows_the_study(flat[: match.start()])):
            paper = PRIME_AND_REACH
        if paper is None or not all(map(paper.fullmatch, numbers)):
            wrong.append(f"{before[-25:]} … {match[0]}")
    for match in _TABLES.finditer(flat):
        wrong += [match[0] for number in re.findall(r"S?\d+", match["numbers"].upper()) if number not in TABLES]
    for match in _EQUATIONS.finditer(flat):
        wrong += [match[0] for number in re.findall(r"\d+", match["numbers"]) if int(number) > LAST_EQUATION]
    return wrong


def _follows_the_study(before: str) -> bool:
    """Return True if the sentence so far speaks of *Prime and Reach*: "the study says …, section 5.2"."""
    sentence = re.split(r"[.;|]\s", before)[-1]
    return re.search(r"Prime and Reach|\b[Tt]he (?:study|paper)\b", sentence) is not None


def test_citations_resolve():
    assert found_in(FILES, unresolved_citations) == {}


def test_sections_are_those_of_a_paper():
    assert found_in(FILES, unknown_sections) == {}


def test_nothing_outside_the_repository_is_cited():
    code = [path for path in FILES if path.suffix != ".md"]
    assert found_in(code, old_citations) == {}
    # Links between pages are relative ("methods/pr.md"); they are resolved on their own.
    assert found_in(PAGES, lambda text: old_citations(_LINK.sub("", text))) == {}


def test_links_between_pages_resolve():
    wrong = {name_of(page): unresolved_links(page, text_of(page)) for page in PAGES}
    assert {page: links for page, links in wrong.items() if links} == {}


def test_paths_named_by_pages_exist():
    pages = [page for page in PAGES if page.name != "CHANGELOG.md"]  # which tells of what was
    assert found_in(pages, unknown_paths) == {}


def unknown_paths(text: str) -> list[str]:
    """Paths of the repository in backticks that do not exist."""
    named = [match["path"] for match in _PATH.finditer(without_code_blocks(text))]
    return [path for path in named if path not in GENERATED and not all(exists(one) for one in unfolded(path))]


def unfolded(path: str) -> list[str]:
    """The paths behind ``a/{b,c}``; what follows ``::`` or ``#`` names something within the file."""
    path = re.split(r"::|#", path)[0]
    braces = re.search(r"\{([^{}]*)\}", path)
    if braces is None:
        return [path]
    return [path.replace(braces[0], choice, 1) for choice in braces[1].split(",")]


def exists(path: str) -> bool:
    """Return True for a file or folder of the repository, or a pattern that fits one."""
    return any(True for _ in ROOT.glob(re.sub(r"<[^>]*>|NAME", "*", path.rstrip("/"))))


def test_every_page_of_the_specification_is_in_its_index():
    index = text_of(SPECIFICATION / "README.md")
    pages = {path.name for path in SPECIFICATION.glob("*.md")} - {"README.md"}
    assert {page for page in pages if f"({page})" not in index} == set()


def test_every_constant_has_a_source():
    sources = text_of(SPECIFICATION / "constants.md")
    protocol = tomllib.loads(text_of(ROOT / "benchmarks" / "prime_and_reach" / "protocol.toml"))
    names = set(protocol) - {"version"}
    for table in ("curation", "splits", "text", "metrics", "breakdown"):
        names = (names - {table}) | set(protocol[table])
    for table in ("plausible", "plausible_3"):
        names |= set(protocol["metrics"][table])
    for path in (ROOT / "data_manifests").glob("*.toml"):
        manifest = tomllib.loads(text_of(path))
        names |= set(manifest.get("thresholds", {})) | set(manifest.get("in_hand", {}))
    assert {name for name in names if f"`{name}`" not in sources} == set()


@pytest.mark.parametrize(
    "citation",
    [
        "docs/specification/metrics.md#prime-sucess",
        "docs/specification/metric.md",
        "docs/specification/formats/adt.md#joints",
        "docs/table.md#nothing",
    ],
)
def test_a_wrong_citation_is_noticed(citation):
    assert unresolved_citations(f"As defined ({citation}).") == [citation]


@pytest.mark.parametrize(
    "text",
    [
        "(``formats/adt.md`` section 5)",
        "methods/metrics.md, section 1",
        "the encoding of the design",
        "(design, section 2)",
        "design.md",
        "§ 3",
    ],
)
def test_an_old_citation_is_noticed(text):
    assert old_citations(text) != []


@pytest.mark.parametrize(
    "text",
    [
        "(paper, section 9.9)",
        "*Prime and Reach*, sections 3.2 and 7",
        "Prime and Reach, section B.6",
        "(section 4)",
        "GazeMoDiff, section 4.9",
        "Prime and Reach, table S9",
        "Prime and Reach, equation 9",
    ],
)
def test_a_section_that_no_paper_has_is_noticed(text):
    assert unknown_sections(text) != []


@pytest.mark.parametrize(
    "text",
    [
        "(paper, section 3.2)",
        "*Prime and Reach*, sections 3.2 and B.5",
        "The study says so (section 5.2)",
        "GazeMoDiff, section 4.2",
        "the Nymeria paper, sections 3.2 and B.2",
        "paper, table S4",
        "Prime and Reach, equations 1 to 7",
    ],
)
def test_a_section_of_a_paper_is_accepted(text):
    assert unknown_sections(text) == []


def test_anchors_are_those_of_github():
    assert anchor_of("3. The `run.json` file: what (and why)") == "3-the-runjson-file-what-and-why"
    assert anchor_of("Frame, units, clock") == "frame-units-clock"
