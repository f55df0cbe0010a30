"""Blind pairs: a page that does not know its key, in a browser, and what the saved answers say."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest

from prbench.errors import InputFileError, UsageError
from prbench.viewing.pairs import KEY, PAGE, BlindPair, Question, answers_table, read_key, write_pairs
from prbench.viewing.replay.scene import RECORDED
from tests.browser import browser, page  # noqa: F401 - fixtures
from tests.viewing.replay.scenes import a_scene

ASKED = {"questions": [Question(name="right", text="Which one was recorded?")], "counted": (RECORDED,)}


def shown(count: int = 6, **changes: str) -> list[BlindPair]:
    made = a_scene("pr, goal-loc", with_eyes=True, notice="Not for trade.")
    about = [
        {"sequence_id": f"made-up/{n}", "recording_id": f"room {n % 3}", "title": "pick </script>"}
        for n in range(count)
    ]
    return [BlindPair.of(replace(made, **{**each, **changes})) for each in about]


def answers(folder: Path, name: str, choices: dict[int, str], **changes: object) -> Path:
    path = folder / f"{name}.json"
    path.write_text(json.dumps({"page": read_key(folder).page, "judge": name, "answers": choices} | changes))
    return path


def right_sides(folder: Path) -> dict[int, str]:
    return {n: "AB"[pair.sides.index(RECORDED)] for n, pair in enumerate(read_key(folder).pairs, 1)}


def test_the_page_hides_whose_motions_it_shows_and_a_seed_decides_their_order(tmp_path) -> None:
    key = write_pairs(shown(), tmp_path / "one", seed=1, **ASKED)
    text = (tmp_path / "one" / PAGE).read_text(encoding="utf-8")
    told = [json.loads(each) for each in re.findall(r'class="pair">(.*?)</script>', text)]
    assert [each["sequence_id"] for each in told] == [f"pair {n}" for n in range(1, 7)]
    names = {"label": "AB", "kind": ("method", "method"), "colour": ("#0072b2", "#d55e00")}
    for each in told:
        assert {name: tuple(motion[name] for motion in each["motions"]) for name in names} == {
            name: tuple(values) for name, values in names.items()
        }
        assert not any(motion[told] for motion in each["motions"] for told in ("gaze", "head", "scores", "sliding"))
    data = text[text.index('id="data"') : text.index("</script>\n<script>")]  # all but the player
    assert not any(word in data for word in ("made-up", "room 1", RECORDED, "pr, goal-loc"))
    assert "Not for trade." in text
    assert sorted(pair.sides.index(RECORDED) for pair in key.pairs) == [0, 0, 0, 1, 1, 1]
    assert {pair.sequence_id for pair in key.pairs} == {f"made-up/{n}" for n in range(6)}
    write_pairs(shown(), tmp_path / "two", seed=1, **ASKED)
    for name in (PAGE, KEY):
        assert (tmp_path / "two" / name).read_bytes() == (tmp_path / "one" / name).read_bytes()
    with pytest.raises(UsageError, match="is the key of another page"):
        write_pairs(shown(), tmp_path / "one", seed=2, **ASKED)
    assert read_key(tmp_path / "one") == key


def test_answers_are_counted_by_person_and_dataset(tmp_path) -> None:
    two = [*shown(4), *shown(4, dataset="other")]
    key = write_pairs(two, tmp_path, seed=0, **ASKED)
    right = right_sides(tmp_path)
    other = {"A": "B", "B": "A"}
    mixed = {n: side if key.pairs[n - 1].dataset == "other" else other[side] for n, side in right.items()}
    table = answers_table(tmp_path, [answers(tmp_path, "Ann", right), answers(tmp_path, "Bo", mixed)])
    shares = {row.text["answers"]: row.cells[0].value for row in table.blocks[0].rows}
    assert shares == {
        "16 everybody": 75.0,
        "8 by Ann": 100.0,
        "8 by Bo": 50.0,
        "8 of made-up": 50.0,
        "8 of other": 100.0,
    }
    everybody = table.blocks[0].rows[0].cells[0]
    assert everybody.low is not None
    assert everybody.low < 75 < everybody.high
    assert everybody.recordings == 6
    assert "8 of 8 pairs were answered" in table.notes[0]


def test_each_question_is_counted_for_both_sides(tmp_path) -> None:
    questions = [Question(name=name, text=f"More {name}?") for name in ("realism", "precision")]
    sides = (RECORDED, "pr, goal-loc")
    key = write_pairs(shown(4), tmp_path, seed=4, questions=questions, counted=sides)
    # Numbers go pair by pair, and question by question of a pair. Realism: the first label; precision: the other.
    # Seed 4 flips every second pair, so that no other order of numbers gives the same shares.
    choices = {2 * n + q + 1: "AB"[pair.sides.index(sides[q])] for n, pair in enumerate(key.pairs) for q in (0, 1)}
    del choices[8]
    table = answers_table(tmp_path, [answers(tmp_path, "Ann", choices)])
    found = {row.text["chosen"]: {cell.metric: cell.value for cell in row.cells} for row in table.blocks[0].rows[:2]}
    assert found == {sides[0]: {"realism": 100.0, "precision": 0.0}, sides[1]: {"realism": 0.0, "precision": 100.0}}
    assert [cell.sequences for cell in table.blocks[0].rows[0].cells] == [4, 3]
    assert table.blocks[0].rows[0].text["answers"] == "7 everybody"
    assert "7 of 8 questions were answered" in table.notes[0]
    assert [column.key for column in table.columns] == ["answers", "chosen", "realism", "precision"]


@pytest.mark.parametrize(
    ("choices", "changes", "told"),
    [
        ({7: "A"}, {}, "answers.7: expected one answer of 'Bo' to each number from 1 to 6"),
        ({1: "C"}, {}, "Invalid enum value 'C'"),
        ({1: "A"}, {"page": "f00"}, "expected answers to the page of .*, found those to another"),
        (
            {1: "A"},
            {"judge": "twice"},
            "answers.1: expected one answer of 'twice' to each number .*another: A",
        ),
        ({1: "A"}, {"answers": 3}, "Expected `object`"),
    ],
)
def test_answers_that_are_none_to_this_page_are_refused(tmp_path, choices, changes, told) -> None:
    write_pairs(shown(), tmp_path, seed=0, **ASKED)
    first = answers(tmp_path, "twice", {1: "B"})
    with pytest.raises(InputFileError, match=told):
        answers_table(tmp_path, [first, answers(tmp_path, "Bo", choices, **changes)])


@pytest.mark.slow
def test_a_person_answers_by_keys_goes_on_later_and_saves_a_file_that_is_counted(page, tmp_path) -> None:  # noqa: F811
    write_pairs(shown(), tmp_path, seed=0, **ASKED)
    right = right_sides(tmp_path)
    page.set_viewport_size({"width": 480, "height": 500})
    page.goto((tmp_path / PAGE).as_uri())
    assert page.locator("#question").text_content() == "Which one was recorded?"
    page.get_by_label("Pause").wait_for()  # it plays by itself
    page.keyboard.press(" ")
    page.get_by_label("Play (Space)").wait_for()
    page.emulate_media(reduced_motion="reduce")
    page.keyboard.press("s")
    assert "First write a name" in page.locator("#said").text_content()
    page.locator("#player canvas").click()  # keys are heard before the player, which has views of the same names
    for number in (1, 2, 3):
        page.keyboard.press("12"["AB".index(right[number])])
    page.reload()
    assert page.locator("#place").text_content() == "pair 4 of 6; 3 answered"
    page.keyboard.press("u")
    assert page.locator("#place").text_content() == "pair 3 of 6; 3 answered"
    assert page.locator(f"#{right[3]}").get_attribute("aria-pressed") == "true"
    page.keyboard.press("n")
    for number in (4, 5, 6):
        page.locator(f"#{right[number]}").click()
    assert "All pairs are answered" in page.locator("#said").text_content()
    page.locator("#judge").fill("Ann/1")
    with page.expect_download() as saved:
        page.locator("#save").click()
    assert saved.value.suggested_filename == "answers-Ann-1.json"
    saved.value.save_as(tmp_path / "saved.json")
    row = answers_table(tmp_path, [tmp_path / "saved.json"]).blocks[0].rows[0]
    assert (row.text["answers"], row.cells[0].value) == ("6 everybody", 100.0)
