"""What a licence keeps is left out or refused, unless the user states permission for that very dataset."""

from __future__ import annotations

import dataclasses

import msgspec
import pytest

from prbench.errors import RedistributionError
from prbench.harness.request import RunRequest
from prbench.harness.run import run_method
from prbench.sequences import DatasetInfo
from prbench.sequences.dataset_info import (
    NOTICE_FILE,
    may_pass_on,
    notice,
    require_may_pass_on,
    run_notice,
    strictest,
)
from prbench.viewing.explain import draw_event_story, explain_event
from tests.fakes import fake_dataset


@dataclasses.dataclass(frozen=True)
class Terms:
    dataset: str
    title: str
    redistribution: str


KEPT, RESEARCH, FREE = (Terms("d", "The data", kind) for kind in ("none", "non-commercial", "yes"))


def with_terms(folder, redistribution):
    """The table in ``folder`` under other terms."""
    msgspec.structs.replace(DatasetInfo.read(folder), redistribution=redistribution).write(folder)


def test_only_none_needs_permission_and_only_for_its_own_name() -> None:
    assert [may_pass_on(terms) for terms in (KEPT, RESEARCH, FREE)] == [False, True, True]
    assert may_pass_on(KEPT, ["d"])
    assert not may_pass_on(KEPT, ["another"])


def test_a_word_that_nobody_knows_counts_as_the_strictest() -> None:
    assert not may_pass_on(Terms("d", "The data", "maybe"))
    assert strictest(["yes", "maybe"]) == "none"
    assert strictest(["yes", "non-commercial"]) == "non-commercial"


def test_a_refusal_says_how_to_state_permission() -> None:
    with pytest.raises(RedistributionError, match=r"an export would hold them.*--permission d$"):
        require_may_pass_on(KEPT, "an export")
    require_may_pass_on(KEPT, "an export", ["d"])
    require_may_pass_on(RESEARCH, "an export")


def test_notices_say_what_the_terms_ask() -> None:
    assert notice(FREE) == ""
    assert "non-commercial purposes only" in notice(RESEARCH)
    assert "left out" in notice(KEPT)
    assert "permission" in notice(KEPT, ["d"])
    assert run_notice(FREE, recorded_motion=True) == ""
    assert "recorded motion itself; they must not leave your machine" in run_notice(KEPT, recorded_motion=True)
    assert "non-commercial" in run_notice(RESEARCH, recorded_motion=False)


@pytest.mark.parametrize("kind", ["none", "non-commercial", "yes"])
def test_a_picture_shows_recorded_motion_only_where_it_may(kind, tmp_path) -> None:
    table = fake_dataset(tmp_path / "table", 4)
    with_terms(table.folder, kind)
    event = table.events()["event_id"][0].as_py()
    story = explain_event(table.folder, event)
    assert (story.motion is None) == (kind == "none")
    assert bool(story.notice) == (kind != "yes")
    assert explain_event(table.folder, event, permitted=["synthetic-adt"]).motion is not None
    draw_event_story(story, tmp_path / "story.png")
    assert (tmp_path / "story.png").stat().st_size > 10_000


@pytest.mark.parametrize("kind", ["none", "non-commercial", "yes"])
def test_a_run_folder_carries_the_notice(kind, tmp_path) -> None:
    table = fake_dataset(tmp_path / "table", 24)
    with_terms(table.folder, kind)
    report = run_method(RunRequest(method="ground-truth", data=(table.folder,), out=tmp_path / "run"))
    file = report.folder.dataset("synthetic-adt").path / NOTICE_FILE
    assert file.is_file() == (kind != "yes")
    if kind == "none":
        assert "must not leave your machine" in file.read_text("utf-8")
    again = run_method(RunRequest(method="ground-truth", data=(table.folder,), out=tmp_path / "run"))
    assert again.batches_made == 0, "the notice does not stand in the way of resuming"
