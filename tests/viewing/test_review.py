"""The page to look through events: its numbers, its filters, what it keeps safe, and the file that it saves."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from prbench.cli import main
from prbench.curation import BuildOptions, CurationOptions, build_dataset
from prbench.curation.corrections import CHANGES, COLUMNS, read_corrections
from prbench.engine.pool import ProcessPool
from prbench.errors import InputFileError, RedistributionError, UsageError
from prbench.sequences import DatasetInfo, SequenceTable
from prbench.synthetic.write_tree import synthesize_tree
from prbench.viewing.review import write_review
from tests.browser import browser  # noqa: F401 - fixture
from tests.browser import page as opened  # noqa: F401 - fixture
from tests.shared import made_once

NODE = shutil.which("node")
HOSTILE = "</script><script>alert(1)</script><b>cup</b>"


def made(dataset: str) -> Path:
    """Two synthetic recordings of a dataset below ``raw``, and their table ``table``."""

    def make(place: Path) -> None:
        synthesize_tree(dataset, place / "raw", recordings=2, seed=4, n_events=2)
        build_dataset(dataset, place / "raw", place / "table")

    return made_once(f"reviewed-{dataset}", make)


def page(place: Path, out: Path, **chosen: Any) -> dict:
    """Return the numbers of a page."""
    write_review(chosen.pop("table", place / "table"), place / "raw", out, **chosen)
    text = out.read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, flags=re.DOTALL)
    return json.loads(data)


def at(data: dict, event: dict, curve: str, time: float) -> int:
    return event["picture"][curve][round((time + data["before"]) / data["step"])]


@pytest.mark.parametrize("dataset", ["adt", "hd-epic"])
def test_the_curves_show_what_decided(dataset, tmp_path) -> None:
    place = made(dataset)
    data = page(place, tmp_path / "page.html")
    assert len(data["events"]) == len(SequenceTable.open(place / "table").events())
    primed = [event for event in data["events"] if event["prime"] is not None]
    assert primed
    for event in primed:
        assert event["event"] == pytest.approx(0.0, abs=2e-3)  # nothing is corrected
        assert 0 <= at(data, event, "gaze", event["prime"]) <= data["near"]
        near = [at(data, event, side, 0.0) for side in ("left", "right")]
        # The rule's points touch a held object; a tracked wrist comes about as near to the annotated point.
        assert min(value for value in near if value >= 0) <= (data["held"] or 250)
        assert len(event["picture"]["above"]["head"]) == len(event["picture"]["gaze"]) // data["every"] + 1
    if dataset == "adt":
        pick = next(event for event in primed if event["title"].startswith("pick"))
        assert at(data, pick, "speed", -0.4) < data["moving"] < at(data, pick, "speed", 0.4)


def test_the_most_doubtful_event_comes_first(tmp_path) -> None:
    place = made("adt")
    table = SequenceTable.open(place / "table")
    events = page(place, tmp_path / "page.html")["events"]
    sure = {row["event_id"]: row["event_confidence"] for row in table.events().to_pylist()}
    order = [1.0 if sure[event["id"]] is None else sure[event["id"]] for event in events]
    assert order == sorted(order)
    assert page(place, tmp_path / "few.html", limit=2)["events"] == events[:2]


def test_only_the_chosen_events_are_shown(tmp_path) -> None:
    place = made("adt")
    rows = SequenceTable.open(place / "table").events().to_pylist()
    first = rows[0]
    for chosen, wanted in (
        ({"outcomes": [first["outcome"]]}, lambda row: row["outcome"] == first["outcome"]),
        ({"recordings": "*seq001*"}, lambda row: "seq001" in row["recording_id"]),
        ({"objects": first["object_name"]}, lambda row: row["object_name"] == first["object_name"]),
    ):
        shown = {event["id"] for event in page(place, tmp_path / "page.html", **chosen)["events"]}
        assert shown == {row["event_id"] for row in rows if wanted(row)}
    for name, chosen, told in (
        ("none.html", {"objects": "no such thing"}, f"found none among {len(rows)}"),
        ("none.html", {"outcomes": ["not_prmed"]}, "Did you mean 'not_primed'?"),
        ("none.pdf", {}, "a file that ends in .html, found '.pdf'"),
    ):
        with pytest.raises(UsageError, match=re.escape(told)):
            page(place, tmp_path / name, **chosen)
        assert not (tmp_path / name).exists()


def test_pages_are_equal_whatever_the_number_of_workers(tmp_path) -> None:
    place = made("adt")
    page(place, tmp_path / "one.html")
    page(place, tmp_path / "two.html", engine=ProcessPool(2))
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()


def test_no_name_becomes_markup_and_nothing_is_loaded(tmp_path) -> None:
    place = made("adt")
    event = SequenceTable.open(place / "table").events()["event_id"][0].as_py()
    corrections = tmp_path / "c.csv"
    corrections.write_text(f'{",".join(COLUMNS)}\n{event},rename,{HOSTILE},"{HOSTILE}",MM\n')
    options = BuildOptions(CurationOptions(shift=(("gaze", 0.4),)), corrections=read_corrections(corrections))
    build_dataset("adt", place / "raw", tmp_path / "table", options=options)
    data = page(place, tmp_path / "page.html", table=tmp_path / "table")
    for each in data["events"]:  # streams are shifted as for the table: the first look begins at the prime
        if each["prime"] is not None:
            looks = [0 <= at(data, each, "gaze", each["prime"] + later) <= data["near"] for later in (-0.15, 0.0)]
            assert looks == [False, True]
    (shown,) = (each for each in data["events"] if each["id"] == event)
    assert HOSTILE in shown["title"] and HOSTILE in shown["corrected"]  # noqa: PT018
    assert data["notice"].startswith("This table was built with corrections: load their file first")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    tags: list[str] = []
    addresses: list[str] = []

    class Look(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            tags.append(tag)
            addresses.extend(name for name, _ in attrs if name in ("src", "href", "action"))

    Look().feed(text)
    motions = text.count('<script type="application/json" id="motion-')
    assert motions == len(data["events"])
    assert tags.count("script") == 3 + motions
    assert addresses == []
    # The player's own library names the standards of SVG by their addresses, which nothing opens.
    assert "http" not in re.sub(r"<script.*?</script>|http-equiv", "", text, flags=re.DOTALL)


def motions(out: Path) -> dict[int, dict]:
    """Return the documents of the bodies on a page, by the place of their event."""
    found = re.findall(r'id="motion-(\d+)">(.*?)</script>', out.read_text(encoding="utf-8"), flags=re.DOTALL)
    return {int(number): json.loads(text) for number, text in found}


def test_a_body_is_played_from_three_seconds_before_its_event_to_one_after(tmp_path, monkeypatch) -> None:
    place = made("adt")
    out = tmp_path / "page.html"
    data = page(place, out)
    for number, document in motions(out).items():
        event = data["events"][number]
        assert document["sequence_id"] == event["id"]
        assert (document["n_frames"], document["fps"], document["event_time"]) == (80, 20.0, 3.0)
        if event["prime"] is not None:
            assert document["prime_time"] == pytest.approx(event["prime"] + 3.0, abs=0.002)
        (motion,) = document["motions"]
        joints = np.frombuffer(base64.b64decode(motion["joints"]), "<i2").reshape(80, 22, 3) / 1000
        assert joints[..., 1].min() == pytest.approx(0.0, abs=0.001)
        wrist = np.linalg.norm(joints[60, [20, 21]] - document["goal"]["location"], axis=1).min()
        assert wrist == pytest.approx(np.frombuffer(base64.b64decode(motion["wrist"]), "<i2")[60] / 1000, abs=0.002)
        near = min(value for value in (at(data, event, side, 0.0) for side in ("left", "right")) if value >= 0)
        assert abs(1000 * wrist - near) < 200  # a wrist and the middle finger's base lie this far apart
    whole = len(motions(out))
    size = max(len(json.dumps(document)) for document in motions(out).values())
    monkeypatch.setattr("prbench.viewing.review.LARGEST_MOTIONS", 2 * size)
    assert write_review(place / "table", place / "raw", out).motions == len(motions(out)) == 2 < whole


def test_the_player_opens_below_an_event_and_closes_again(opened, tmp_path) -> None:  # noqa: F811
    place = made("adt")
    data = page(place, tmp_path / "page.html")
    opened.goto((tmp_path / "page.html").as_uri())
    opened.keyboard.press("p")
    opened.wait_for_selector(".card.here .motion canvas")
    opened.keyboard.press("j")
    opened.keyboard.press("p")
    opened.wait_for_selector(".card.here .motion canvas")
    assert opened.locator("canvas").count() == 1
    assert opened.locator(".card.here .id").inner_text() == data["events"][1]["id"]
    opened.keyboard.press("p")
    opened.wait_for_selector("canvas", state="detached")


def test_where_the_licence_keeps_recorded_motion_the_page_needs_permission(tmp_path) -> None:
    place = made("adt")
    table = Path(shutil.copytree(place / "table", tmp_path / "table"))
    info = DatasetInfo.read(table)
    msgspec.structs.replace(info, redistribution="none").write(table)
    with pytest.raises(RedistributionError, match="--permission synthetic-adt"):
        page(place, tmp_path / "page.html", table=table)
    assert not (tmp_path / "page.html").exists()
    data = page(place, tmp_path / "page.html", table=table, permitted=["synthetic-adt"])
    assert "do not pass it on" in data["notice"]


def test_events_of_a_recording_that_is_gone_are_shown_without_pictures(tmp_path, capsys) -> None:
    place = Path(shutil.copytree(made("adt"), tmp_path / "place"))
    names = sorted(path.name for path in place.glob("raw/*seq00*"))
    shutil.rmtree(place / "raw" / names[0])
    out = tmp_path / "page.html"
    words = ["review", str(place / "table"), "--root", str(place / "raw"), "--out", str(out)]
    assert main(words) == 3
    assert f"no pictures: {names[0]}: this recording is not below --root" in capsys.readouterr().err
    pictures = {event["id"].split("/")[1]: bool(event["picture"]) for event in page(place, out)["events"]}
    assert pictures == {names[0]: False, names[1]: True}
    with pytest.raises(InputFileError, match=f"recordings of .*, such as {names[0]}, found others"):
        page(place, out, recordings=f"{names[0]}")


def javascript(expression: str, **values: object) -> object:
    """Evaluate an expression beside the functions of the page's script, which has no page here."""
    text = (Path(write_review.__code__.co_filename).with_name("review.html")).read_text(encoding="utf-8")
    script = text[text.rindex("<script>") + len("<script>") : text.rindex("</script>")]
    given = "".join(f"const {name} = {json.dumps(value)};\n" for name, value in values.items())
    program = f"{script}\n{given}process.stdout.write(JSON.stringify({expression}));"
    assert NODE is not None
    done = subprocess.run([NODE, "-"], input=program.encode(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return json.loads(done.stdout)


DECIDED = {
    "adt/room_0/1/pick/14167034": [
        {"change": "move", "value": "-0.40", "reason": 'late, "by" eye\nand\' hand', "author": "Müller, M"},
        {"change": "hand", "value": "left", "reason": "=SUM(A1)", "author": "-"},
    ],
    "adt/room_1/1/put/2": [{"change": "drop", "value": "", "reason": "'tis nothing", "author": "@m"}],
    "adt/room_1/1/put/3": [{"change": "goal", "value": "-0.5 0.9 1", "reason": "'=quoted", "author": "𝕄"}],
    "adt/room_2/1/put/4": [{"change": "accept", "value": "", "reason": "looks right", "author": "MM"}],
    "adt/room_2/1/put/5": [{"change": "note", "value": "", "reason": "unsure", "author": "MM"}],
}


@pytest.mark.skipif(NODE is None, reason="node is not installed")
def test_what_the_page_saves_is_what_the_build_reads_and_what_the_page_loads(tmp_path) -> None:
    expression = "toCsv(new Map(Object.entries(decisions)), columns)"
    text = javascript(expression, decisions=DECIDED, columns=COLUMNS)
    assert isinstance(text, str)
    (tmp_path / "corrections.csv").write_text(text, encoding="utf-8", newline="")
    read: dict[str, list] = {}
    for row in read_corrections(tmp_path / "corrections.csv").rows:
        read.setdefault(row.event_id, []).append(dict(zip(COLUMNS[1:], row[1:5], strict=True)))
    wanted = {name: sorted(rows, key=lambda row: row["change"]) for name, rows in DECIDED.items()}
    assert read == wanted
    loading = "Object.fromEntries(readCorrections(text, columns, changes))"
    for form in (text, "\ufeff" + text.replace("\n", "\r\n"), text.replace("author\n", "author,,\n")):
        assert javascript(loading, text=form, columns=COLUMNS, changes=CHANGES) == wanted


@pytest.mark.skipif(NODE is None, reason="node is not installed")
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("event_id;change\n", "line 1: expected the columns event_id,change,value,reason,author"),
        (f"{','.join(COLUMNS)}\na,drop,,seen\n", "line 2: 4 cells"),
        (f"{','.join(COLUMNS)}\n\na,constructor,,seen,MM\n", "line 3: unknown change 'constructor'"),
        (f"{','.join(COLUMNS)}\na,drop,,,MM\n", "line 2: event_id, reason and author are needed"),
        (f"{','.join(COLUMNS)}\na,drop,,s,MM\na,drop,,s,MM\n", "line 3: 'drop' is repeated"),
        (f'{",".join(COLUMNS)}\na,drop,,"s,MM\n', "line 2: a double quote never ends"),
    ],
)
def test_a_file_that_the_page_cannot_load_is_told_with_its_line(text, told) -> None:
    expression = (
        "(() => { try { readCorrections(text, columns, changes); } catch (error) { return error.message; } })()"
    )
    assert told in str(javascript(expression, text=text, columns=COLUMNS, changes=CHANGES))


@pytest.mark.skipif(NODE is None, reason="node is not installed")
@pytest.mark.parametrize(
    ("steps", "rows"),
    [
        ('decided(rows, "drop", "", "M")', [("drop", "", "not such an event")]),
        ('decided(decided(rows, "drop", "", "M"), "accept", "", "M")', [("accept", "", "looks right")]),
        ('decided(decided(rows, "move", "-0.40", "M"), "move", "-0.45", "M")', [("move", "-0.45", "moved by eye")]),
        ('decided(decided(rows, "move", "-0.40", "M"), "move", "", "M")', []),
        ('decided(decided(rows, "accept", "", "M"), "hand", "left", "M")', [("hand", "left", "the other hand")]),
        ('noted(rows, "unsure", "M")', [("note", "", "unsure")]),
        ('decided(noted(rows, "blurred", "M"), "drop", "", "M")', [("drop", "", "blurred")]),
        ('decided(decided(noted(rows, "late", "M"), "move", "1.00", "M"), "move", "", "M")', [("note", "", "late")]),
        ('noted(noted(decided(rows, "drop", "", "M"), "x", "M"), "", "M")', [("drop", "", "not such an event")]),
    ],
)
def test_one_decision_after_another_never_contradicts_itself(steps, rows) -> None:
    found = javascript(steps, rows=[])
    assert isinstance(found, list)
    assert [(row["change"], row["value"], row["reason"]) for row in found] == rows
