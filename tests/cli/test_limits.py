"""``--limit``: one meaning wherever sequences are counted, another one where recordings are."""

from __future__ import annotations

import pytest

from prbench.cli.main import main
from prbench.cli.options import FIRST_RUN_SEQUENCES
from prbench.harness import first_run
from tests.fakes import fake_dataset
from tests.parsing import all_commands


def explained(command: str, option: str = "--limit") -> str:
    """What ``--help`` says about the option."""
    (found,) = [each for each in all_commands()[command].params if option in each.opts]
    return str(found.help)


def test_commands_that_count_the_same_explain_it_in_the_same_words() -> None:
    sequences = {explained(name).partition(" (default")[0] for name in ("run", "export-conditions", "score", "view")}
    assert sequences == {
        "At most N sequences of each dataset, of every recording its share, for every command the same"
    }
    recordings = {explained(name, "--max-recordings") for name in ("build-dataset", "build-corpus", "poses")}
    assert recordings == {"At most N recordings: the first by name."}


def test_the_help_of_a_run_tells_how_many_sequences_it_takes_without_data() -> None:
    assert first_run.SEQUENCES == FIRST_RUN_SEQUENCES
    assert f"{FIRST_RUN_SEQUENCES} without --data" in explained("run")


@pytest.mark.parametrize("limit", [[], ["--limit", "5"]])
def test_an_export_of_the_embedded_dataset_says_which_limit_matches_a_run(tmp_path, monkeypatch, capsys, limit) -> None:
    fake_dataset(tmp_path / "embedded", 60)
    monkeypatch.setattr(first_run, "default_table_folders", lambda: (tmp_path / "embedded",))
    words = ["export-conditions", "--data", str(tmp_path / "embedded"), "--condition", "text"]
    assert main([*words, "--out", str(tmp_path / "c.npz"), *limit]) == 0
    told = "--limit 10 exports the same ones" in capsys.readouterr().err
    assert told is (not limit)
