"""A table of events alone, as HD-EPIC is before EgoAllo: what works on it, and what says why it does not."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from prbench.cli.main import main
from prbench.curation import build_from_sources
from prbench.errors import TableError
from prbench.recording import Recording
from prbench.sequences import SequenceTable
from prbench.viewing.explain import explain_event
from prbench_adapters.training import SequenceDataset
from tests.curation.sources import SceneSource


@dataclass(frozen=True)
class WithoutBody(SceneSource):
    """The scene as glasses alone see it."""

    def read(self) -> Recording:
        return replace(super().read(), body=None, pose_source="none")


@pytest.fixture(scope="module")
def table(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("table") / "adt"
    build_from_sources([WithoutBody("room_a"), WithoutBody("room_b", version=1)], folder)
    return folder


def test_it_is_opened_and_its_events_and_recordings_are_read(table) -> None:
    opened = SequenceTable.open(str(table))
    outcomes = opened.events()["outcome"].to_pylist()
    assert "no_body" in outcomes
    assert opened.recordings().num_rows == 2
    assert opened.scalars().num_rows == 0
    assert list(opened.chunks()) == []
    assert opened.content == opened.info.content_digest


def test_statistics_stories_and_comparisons_work_on_it(table, tmp_path, capsys) -> None:
    assert main(["inspect", str(table)]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "no sequences. 2 of 2 recordings were read; what became of their" in told
    assert "no_body" in told
    assert main(["diff", str(table), str(table)]) == 0
    (event, *_) = SequenceTable.open(table).events()["event_id"].to_pylist()
    assert explain_event(str(table), event).event.event_id == event
    assert main(["explain", event, "--data", str(table)]) == 0
    capsys.readouterr()
    assert main(["study", "figure-s2", str(table), "--out", str(tmp_path / "s2.png")]) == 4
    assert "nothing to draw" in capsys.readouterr().err
    assert not (tmp_path / "s2.png").exists()


def test_what_needs_sequences_says_that_there_are_none_and_why(table, tmp_path, capsys) -> None:
    commands = [
        ["run", "--method", "ground-truth", "--data", str(table), "--out", str(tmp_path / "run")],
        ["export-conditions", "--data", str(table), "--condition", "text", "--out", str(tmp_path / "c.npz")],
        ["view", "--data", str(table), "--out", str(tmp_path / "v.png")],
        ["export-release", str(table), "--out", str(tmp_path / "release")],
    ]
    for words in commands:
        assert main(words) == 4, words[0]
        error = capsys.readouterr().err
        assert f"{table}: holds no sequences. 2 of 2 recordings were read" in error, words[0]
        assert "no_body" in error
        assert "prbench poses egoallo" in error
    with pytest.raises(TableError, match="holds no sequences"):
        SequenceDataset(table)
    assert list(tmp_path.iterdir()) == []
