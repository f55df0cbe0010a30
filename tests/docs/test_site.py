"""The documentation as a site: it builds without a warning, agrees with the pages, and loads nothing from outside."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import pytest
from filelock import FileLock

from tests.docs.test_citations import ROOT, headings

pytest.importorskip("mkdocs", reason="the site needs pip install 'prbench[docs]'")
pytest.importorskip("mkdocstrings", reason="the site needs pip install 'prbench[docs]'")

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "node_modules" not in path.parts)

QUESTIONS = {
    "what is priming": "index.html#what-is-priming",
    "Goal MPJPE": "glossary.html#goal-mpjpe",
    "Location Error": "glossary.html#location-error",
    "foot skating": "glossary.html#foot-skating",
    "prime gap": "glossary.html#prime-gap",
    "HD-EPIC": "datasets.html#hd-epic",
    "adding method": "adding-a-method.html",
    "hand reached": "table.html#which-hand-reached",
    "install GPU": "index.html#install-and-try-it",
    "canonical frame": "glossary.html#canonical-frame",
}
"""What a newcomer types into the search, and a page or section that answers it."""


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The built site, made once for all workers; ``PRBENCH_SITE`` names one that was built already."""
    if built := os.environ.get("PRBENCH_SITE"):
        return Path(built)
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with FileLock(shared / "site.lock"):
        if not (shared / "site").is_dir():
            _build(shared / "site")
    return shared / "site"


def _build(folder: Path) -> None:
    draft = folder.with_name("site-draft")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(draft)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    draft.rename(folder)


class _Page(HTMLParser):
    """Ids of headings, targets of links, and what is loaded."""

    def __init__(self) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.headings: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.counts: dict[str, int] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        self.counts[tag] = self.counts.get(tag, 0) + 1
        if "id" in given:
            self.ids.add(given["id"])
            if re.fullmatch("h[1-6]", tag):
                self.headings.add(given["id"])
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        if "src" in given:
            self.loaded.append(given["src"])
        if tag == "link" and given.get("rel") not in ("canonical", "next", "prev"):
            self.loaded.append(given["href"])


@cache
def page(path: Path) -> _Page:
    """A page of the site."""
    parsed = _Page()
    parsed.feed(path.read_text(encoding="utf-8"))
    return parsed


def html_of(source: Path) -> str:
    """Where a page of ``docs`` stands in the site."""
    below = source.relative_to(DOCS).with_suffix(".html")
    return below.with_name("index.html").as_posix() if below.stem == "README" else below.as_posix()


def test_headings_have_the_ids_that_citations_use(site):
    missing = {source.name: headings(source) - page(site / html_of(source)).ids for source in PAGES}
    assert {name: ids for name, ids in missing.items() if ids} == {}


def test_links_between_pages_lead_somewhere(site):
    wrong = []
    for path in site.rglob("*.html"):
        if path.name == "404.html":  # its links begin at the root of the host
            continue
        for link in page(path).links:
            target, _, heading = link.partition("#")
            if re.match("[a-z]+:", target):
                continue
            goal = (path.parent / target).resolve() if target else path
            if not goal.is_file() or (heading and goal.suffix == ".html" and heading not in page(goal).ids):
                wrong.append(f"{path.relative_to(site)}: {link}")
    assert wrong == []


def test_nothing_is_loaded_from_outside(site):
    outside = re.compile(r"(?:[a-z]+:)?//")
    loaded = {path.name: [name for name in page(path).loaded if outside.match(name)] for path in site.rglob("*.html")}
    assert {name: names for name, names in loaded.items() if names} == {}
    fetching = re.compile(r"@import|url\(['\"]?(?:https?:)?//")
    assert [path for path in site.rglob("*.css") if fetching.search(path.read_text("utf-8"))] == []


def test_lists_and_tables_look_as_elsewhere(site):
    """The site reads Markdown by other rules than GitHub: a list that lacks a blank line would become running text."""
    markdown_it = pytest.importorskip("markdown_it")
    reader = markdown_it.MarkdownIt("commonmark").enable("table")
    different = {}
    for source in PAGES:
        if source.name == "command-line.md" or ":::" in source.read_text(encoding="utf-8"):
            continue  # filled in by the build
        expected = _Page()
        expected.feed(reader.render(source.read_text(encoding="utf-8")))
        article = re.search(r"<article.*?</article>", (site / html_of(source)).read_text(encoding="utf-8"), re.DOTALL)
        found = _Page()
        found.feed(article[0])
        for tag in ("li", "tr", "td", "ol", "ul", "strong"):
            wanted = expected.counts.get(tag, 0)
            if found.counts.get(tag, 0) != wanted:
                different[f"{source.relative_to(DOCS)} <{tag}>"] = (found.counts.get(tag, 0), wanted)
    assert different == {}


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_newcomers_question_is_found(site, question):
    index = json.loads((site / "search" / "search_index.json").read_text(encoding="utf-8"))
    words = question.lower().split()
    answers = {
        entry["location"]
        for entry in index["docs"]
        if all(word in (entry["title"] + " " + entry["text"]).lower() for word in words)
    }
    wanted = QUESTIONS[question]
    assert any(answer == wanted or answer.startswith(f"{wanted}#") for answer in answers), answers


def test_the_search_works_in_pages_opened_from_disk(site):
    assert (site / "search" / "search_index.js").read_text(encoding="utf-8").startswith("var __index = ")
    assert "assets/iframe-worker.js" in page(site / "index.html").loaded


def test_every_command_is_on_the_page_of_commands(site):
    text = (site / "command-line.html").read_text(encoding="utf-8")
    for command in ("run", "build-dataset", "score", "leaderboard-compare", "adapters-new", "doctor"):
        assert f'id="prbench-{command}"' in text
