"""``--limit``: one meaning wherever sequences are counted, another one where recordings are."""

from __future__ import annotations

from prbench.cli.options import FIRST_RUN_SEQUENCES
from prbench.harness import first_run
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
