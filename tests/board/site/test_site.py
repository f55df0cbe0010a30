"""A site in a browser and as bytes: tables, charts, pages of runs, pairs, motions, licences, hostile names."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from prbench.board import compare_runs
from prbench.board.comparison import sentence
from prbench.cli import main
from prbench.contract import Condition
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.harness.run_folder.record import FILE_NAME
from tests.browser import browser, page  # noqa: F401 - fixtures
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset
from tests.sequences.test_dataset_info import with_terms
from tests.shared import made_once

HOSTILE = "</script><img src=x onerror=alert(1)>\"'\u202e"
LARGEST_MOTION = 100_000


def make_runs(place: Path) -> None:
    """Runs of two controls and a method on two tables, whose recorded motion the second one's licence keeps."""
    tables = (place / "tables" / "adt", place / "tables" / "gimo")
    fake_dataset(tables[0], 64, recordings=60)
    fake_dataset(tables[1], 64, dataset="synthetic-gimo", recordings=60)
    with_terms(tables[1], "none")
    for name, method, condition in (
        ("truth", "ground-truth", Condition.NONE),
        ("scripted", "scripted", Condition.GOAL_LOCATION),
        ("still", "static", Condition.NONE),
    ):
        run_method(RunRequest(method=method, data=tables, condition=condition, out=place / "runs" / name))
    # Options are anybody's text, and stand in every table.
    file = place / "runs" / "still" / FILE_NAME
    record = json.loads(file.read_text())
    record["method"]["options"] = {"x": HOSTILE}
    file.write_text(json.dumps(record))


@pytest.fixture(scope="module")
def place() -> Path:
    return made_once("runs-of-a-site", make_runs)


def words(place: Path, out: Path, *more: str) -> list[str]:
    return ["leaderboard", "site", str(place / "runs"), "--data", str(place / "tables"), "--out", str(out), *more]


@pytest.fixture(scope="module")
def site(place) -> Path:
    def make(out: Path) -> None:
        assert main(words(place, out, "--motions", "2")) == 0

    return made_once("site-of-a-board", make)


def everything(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_equal_runs_give_equal_bytes_and_replace_a_site_but_nothing_else(place, site, tmp_path, capsys):
    out = tmp_path / "again"
    report = reported(words(place, out, "--motions", "2", "--json"), capsys)
    assert report.runs == ["still", "truth", "scripted"]
    assert everything(out) == everything(site)
    assert main(words(place, out, "--motions", "none")) == 0
    assert not any((out / "motions").iterdir())
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("words")
    refused(words(place, tmp_path / "mine"), capsys, code=8, message="holds no site.json")
    assert (tmp_path / "mine" / "thesis.tex").read_text() == "words"


def test_what_a_licence_keeps_is_left_out_and_said_until_the_user_has_permission(place, site, tmp_path):
    kept = json.loads((site / "site.json").read_text())["left_out"]
    assert any("synthetic-gimo" in line and "--permission synthetic-gimo" in line for line in kept)
    assert "--permission synthetic-gimo" in (site / "index.html").read_text()
    for file in (site / "motions" / "synthetic-gimo").iterdir():
        assert b'"kind":"recorded"' not in file.read_bytes()
        assert b'"kind":"control"' not in file.read_bytes()
        assert b'"goal":{' not in file.read_bytes()
    free = everything(site / "motions" / "synthetic-adt").values()
    assert any(b'"kind":"recorded"' in file and b'"goal":{' in file for file in free)
    out = tmp_path / "permitted"
    assert main(words(place, out, "--motions", "1", "--permission", "synthetic-gimo")) == 0
    assert any(b'"kind":"recorded"' in file for file in everything(out / "motions" / "synthetic-gimo").values())


def test_no_page_needs_a_network_and_no_name_becomes_markup(site):
    for path in site.rglob("*"):
        assert path.stat().st_size < (LARGEST_MOTION if "motions" in path.parts else 3_000_000)
        if path.suffix != ".html":
            continue
        text = path.read_text(encoding="utf-8")
        assert "<img" not in text
        assert "\u202e" not in text
        for address in re.findall(r'(?:src|href)="([^"#]*)', text):
            assert not address or (path.parent / address).resolve().is_file(), address
    for path in site.rglob("*.js"):
        assert "\u202e" not in path.read_text(encoding="utf-8")


def test_tables_sort_filter_and_come_back_from_a_link(page, site):  # noqa: F811
    page.goto((site / "index.html").as_uri())
    shown = "#boards section:not([hidden]) tbody tr:not([hidden]) th a"
    assert page.locator(shown).all_inner_texts() == ["scripted", "ground-truth", "static"]
    page.get_by_role("button", name="Goal MPJPE").click()
    assert page.locator(shown).all_inner_texts()[0] == "ground-truth"
    page.keyboard.press("Enter")
    assert page.locator(shown).all_inner_texts()[-1] == "ground-truth"
    page.locator("[name=dataset]").select_option("synthetic-adt")
    page.locator("#conditions [value=control]").uncheck()
    assert page.locator(shown).all_inner_texts() == ["static"]
    assert page.locator("#count").inner_text() == "1 of 3 rows"
    assert HOSTILE[:30] in page.locator("#boards section:not([hidden]) tr:not([hidden]) .variant").all_inner_texts()[-1]
    link = page.url
    page.goto("about:blank")
    page.goto(link)
    assert page.locator(shown).all_inner_texts() == ["static"]
    page.locator("#plot-rates a.point").first.wait_for(state="attached")  # charts follow the tables
    assert page.locator("#plot-rates a.point").count() == 1
    page.locator("#plot-rates a.point").focus()
    page.keyboard.press("Enter")
    page.wait_for_url("**/runs/still.html")


def test_a_pair_is_told_as_the_command_tells_it(page, place, site):  # noqa: F811
    page.goto((site / "compare.html").as_uri() + "#first=scripted&second=truth")
    compared = compare_runs(place / "runs" / "truth", place / "runs" / "scripted")
    page.locator("#result section").first.wait_for()
    found = page.locator(".sentences li").all_text_contents()
    assert sorted(found) == sorted(sentence(row, "ground-truth", "scripted") for row in compared.metrics)
    assert any("supported by the data (p = " in line for line in found)


def test_a_failure_leads_to_the_player_at_the_moment_that_matters(page, site):  # noqa: F811
    page.goto((site / "runs" / "still.html").as_uri())
    assert page.get_by_text("64 of 64 sequences", exact=False).count() == 0  # only the test split is scored
    page.get_by_role("link", name="Watch the prime").first.click()
    page.locator("#player canvas").wait_for()
    link = page.url
    assert "sequence=synthetic-adt" in link
    assert "t=2.00" in link
    page.goto("about:blank")
    page.goto(link)
    page.locator("#player canvas").wait_for()


@pytest.mark.parametrize("name", ["index.html", "runs/still.html", "compare.html"])
def test_a_screen_reader_finds_nothing_amiss(page, site, name):  # noqa: F811
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.goto((site / name).as_uri())
        page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
        found = axe.Axe().run(page, options={"preload": False}).response["violations"]
        assert [(each["id"], each["nodes"][0]["html"]) for each in found] == []


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--motions", "0"], "--motions 0: expected a number from 1 on, all or none"),
        (["--motions", "some"], "--motions some: expected a number from 1 on"),
    ],
)
def test_bad_input_is_refused_before_anything_is_written(place, tmp_path, capsys, more, message):
    refused(words(place, tmp_path / "site", *more), capsys, code=2, message=message)
    assert not (tmp_path / "site").exists()
