"""The page of the player in a browser: it loads nothing, decodes what it holds, and trusts no name."""

from __future__ import annotations

import dataclasses
import re

from prbench.viewing.player.document import player_sequence
from prbench.viewing.player.page import page_text, write_page
from tests.browser import browser, page  # noqa: F401 - fixtures
from tests.viewing.replay.scenes import a_scene

HOSTILE = "</script><img src=x onerror=alert(1)>__DOCUMENTS__"


def hostile_sequences() -> list:
    scene = a_scene("static, none")
    return [player_sequence(scene), player_sequence(dataclasses.replace(scene, sequence_id="b", title=HOSTILE))]


def test_the_page_asks_for_nothing_and_equal_scenes_are_equal_bytes(tmp_path):
    text = page_text(hostile_sequences(), HOSTILE)
    markup = re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.DOTALL)
    assert not re.findall(r"<[^>]*(?:src|href|action)\s*=", markup)
    assert "<img" not in markup
    assert text == page_text(hostile_sequences(), HOSTILE)
    write_page(hostile_sequences(), tmp_path / "page.html", HOSTILE)
    assert (tmp_path / "page.html").read_text(encoding="utf-8") == text


def test_the_page_opens_from_disk_and_reads_a_motion_when_it_is_chosen(page, tmp_path):  # noqa: F811
    write_page(hostile_sequences(), tmp_path / "page.html")
    page.goto((tmp_path / "page.html").as_uri())
    titles = page.evaluate("prbench.documents.map((entry) => entry.title)")
    assert titles == ["pick of WoodenBowl, right hand (test)", HOSTILE]
    assert page.evaluate("prbench.documents[1].load().then((read) => read.n_frames)") == 61
