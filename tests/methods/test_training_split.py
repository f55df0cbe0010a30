"""A method learns from training rows, even if it forgets to ask for them."""

from __future__ import annotations

import pytest

from prbench.errors import AdapterError
from prbench.evaluation.request import RunRequest
from prbench.evaluation.run import run_method
from prbench.methods.training_split import TrainingSplit
from tests.method_fixtures import adapter_source

CURIOUS = """
        def fit(self, train, *, validation, run):
            run.folder.mkdir(parents=True, exist_ok=True)
            seen = [name for chunk in train.chunks({split}) for name in chunk.sequence_ids]
            (run.folder / "seen").write_text("\\n".join(seen))
"""


def learns(split: str = "") -> str:
    return adapter_source().replace("    def load", f"{CURIOUS.format(split=split)}\n    def load")


def ids(table, split: str) -> list[str]:
    return table.scalars(split=split)["sequence_id"].to_pylist()


def test_all_rows_of_the_view_are_training_rows_and_its_digests_those_of_the_table(table):
    view = TrainingSplit.open(table.folder)
    assert view.scalars()["sequence_id"].to_pylist() == ids(table, "train")
    assert [name for chunk in view.chunks() for name in chunk.sequence_ids] == ids(table, "train")
    assert (view.identity, view.content) == (table.identity, table.content)


def test_events_and_recordings_of_the_view_are_those_of_training_rows(table):
    view = TrainingSplit.open(table.folder)
    assert set(view.recordings()["split"].to_pylist()) == {"train"}
    assert sorted(view.events()["sequence_id"].to_pylist()) == sorted(ids(table, "train"))


@pytest.mark.parametrize("split", ["test", "validation"])
def test_other_splits_are_refused(table, split):
    view = TrainingSplit.open(table.folder)
    for ask in (view.chunks, view.scalars):
        with pytest.raises(AdapterError, match=rf"from split 'train' only; it asked for '{split}'"):
            ask(split=split)


def test_a_method_that_reads_every_row_it_is_given_learns_from_no_test_row(table, tmp_path, install, own_cache):
    install("made", learns())
    run_method(RunRequest(method="made", data=(table.folder,), out=tmp_path / "out"))
    (seen,) = own_cache.glob("fits/made-*/seen")
    assert seen.read_text().splitlines() == ids(table, "train")


def test_a_method_that_asks_for_the_test_split_is_refused(table, tmp_path, install):
    install("made", learns("split='test'"))
    with pytest.raises(AdapterError, match="it asked for 'test'"):
        run_method(RunRequest(method="made", data=(table.folder,), out=tmp_path / "out"))
    assert not (tmp_path / "out").exists()
