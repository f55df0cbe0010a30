"""Releases that say the same in another form become the same table; those that say something else are refused."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from prbench.cli import main
from prbench.errors import InputFileError
from prbench.release.importing import import_release
from prbench.release.reading import ImportOptions
from prbench.sequences import SequenceTable
from tests.release.releases import ROWS, change_targets, imported, table_of, value, write_release


def each_entry(change):
    """Change the fields of every entry."""
    return lambda release: change_targets(release, lambda found: {key: change(dict(e)) for key, e in found.items()})


def whole(change):
    """Change the content of the file."""
    return lambda release: change_targets(release, change)


def renamed(old, new, change=lambda value: value):
    def entry(fields):
        fields[new] = change(fields.pop(old))
        return fields

    return each_entry(entry)


def split_lists(found, spell: Callable[[str], object] = str):
    """Take the subsets out of the entries: keys of each subset."""
    lists = {"train": [], "test": []}
    for key, fields in found.items():
        lists[fields.pop("subset")].append(spell(key))
    return lists


def by_subset(found):
    lists = split_lists(found)
    return {subset: {key: found[key] for key in keys} for subset, keys in lists.items()}


def arrays(change):
    def spoil(release):
        for path in (*release.glob("motions/*.npy"), *release.glob("gazes/*.npy")):
            np.save(path, change(np.load(path)))

    return spoil


SAME = {
    "goal by axes": renamed("goal_location", "goal", lambda goal: dict(zip("xyz", goal))),
    "goal in a list": renamed("goal_location", "goal", lambda goal: [goal]),
    "goal as text": renamed("goal_location", "goal", lambda goal: [str(axis) for axis in goal]),
    "fields of fields": renamed("goal_location", "target", lambda goal: {"position": goal}),
    "is_train": renamed("subset", "is_train", lambda subset: subset == "train"),
    "test as number": renamed("subset", "test", lambda subset: int(subset == "test")),
    "list with ids": whole(lambda found: [{"id": int(key), **fields} for key, fields in reversed(found.items())]),
    "list in order": whole(lambda found: list(found.values())),
    "wrapped": whole(lambda found: {"sequences": found}),
    "by subset": whole(by_subset),
    "lists of keys": whole(lambda found: split_lists(found) | found),
    "lists of numbers": whole(lambda found: {"split": split_lists(found, int), "data": found}),
    "lists of files": whole(lambda found: {"split": split_lists(found, "motions/{}.npy".format), **found}),
    "by field": whole(lambda found: {name: {key: e[name] for key, e in found.items()} for name in found["0000000000"]}),
    "frames from 1": renamed("primed_frame", "primed_frame", lambda frame: frame + 1),
    "frames as floats": renamed("primed_frame", "prime_frame", float),
    "float64": arrays(lambda array: array.astype(np.float64)),
    "big-endian": arrays(lambda array: array.astype(">f4")),
    "Fortran order": arrays(np.asfortranarray),
    "a file beside": lambda release: (release / "README.md").write_text("hello"),
}


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> SequenceTable:
    folder = tmp_path_factory.mktemp("reference")
    imported(folder)
    return table_of(folder)


@pytest.mark.parametrize("name", SAME)
def test_the_same_in_another_form_is_the_same_table(name, reference, tmp_path) -> None:
    report = imported(tmp_path, spoil=SAME[name])
    assert report.left_out == 0
    assert (table_of(tmp_path).identity, table_of(tmp_path).content) == (reference.identity, reference.content)
    assert value(report, "first_frame")[0] == ("1" if name == "frames from 1" else "0")


def test_a_release_in_further_folders_and_with_one_dataset_is_found(reference, tmp_path) -> None:
    write_release(tmp_path / "download" / "PrimeAndReach-main" / "data" / "ADT")
    import_release(tmp_path / "download", tmp_path / "out")
    assert SequenceTable.open(tmp_path / "out" / "adt").scalars().num_rows == len(ROWS)
    write_release(tmp_path / "download" / "PrimeAndReach-main" / "copy" / "adt")
    with pytest.raises(InputFileError, match="adt: expected one folder, found two"):
        import_release(tmp_path / "download", tmp_path / "again")


def test_numbers_with_gaps_keep_their_own(tmp_path) -> None:
    def spoil(release: Path) -> None:
        for kind in ("motions", "gazes"):
            for path in sorted((release / kind).iterdir(), reverse=True):
                path.rename(path.with_name(f"{7 * int(path.stem) + 3:010d}.npy"))
        change_targets(release, lambda found: {str(7 * int(key) + 3): each for key, each in found.items()})

    assert imported(tmp_path, spoil=spoil).left_out == 0
    ids = table_of(tmp_path).scalars()["sequence_id"].to_pylist()
    assert ids == [f"synthetic-adt/{7 * k + 3:010d}/release" for k in range(len(ROWS))]


def test_a_rate_of_30_is_run_and_scored_at_30(tmp_path, capsys) -> None:
    imported(tmp_path, spoil=renamed("primed_frame", "primed_frame", lambda frame: 60 if frame < 0 else frame),
             options=ImportOptions(fps=30.0))  # fmt: skip
    run = ["run", "--method", "scripted", "--condition", "goal-loc", "--data", str(tmp_path / "table")]
    assert main([*run, "--out", str(tmp_path / "run")]) == 0
    assert "MPJPE" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (renamed("subset", "subset", lambda subset: subset == "train"), "subset: expected train or test, found True"),
        (renamed("goal_location", "goal", lambda goal: {"x": goal[0], "y": 0, "w": 1}), "goal: expected one field"),
        (arrays(lambda array: array[..., [0, 2, 1]] * [1, -1, 1]), "heads above pelvises, along y"),
        (whole(lambda found: [*found.values(), {"id": 3}, {"id": 3}]), "sequence 3: expected one key"),
        (whole(lambda found: {**found, "version": "1.0"}), "found a str under the key 'version'"),
    ],
)  # fmt: skip
def test_what_says_something_else_is_refused(spoil, message, tmp_path) -> None:
    with pytest.raises(InputFileError, match=message):
        imported(tmp_path, spoil=spoil)


def test_listed_keys_without_an_entry_are_named(tmp_path) -> None:
    report = imported(tmp_path, spoil=whole(lambda found: {"test": ["0000000077"], **found}))
    assert {each.sequence for each in report.problems if each.left_out} == {"0000000077"}


def test_a_prompt_that_is_not_found_is_told(tmp_path) -> None:
    (warning,) = imported(tmp_path, spoil=renamed("text_prompt", "what to do")).warnings
    assert "--field-map text=NAME says it (other fields: what to do)" in warning


def test_gaze_that_looks_elsewhere_is_told(tmp_path) -> None:
    report = imported(tmp_path, gaze=lambda row: -row.gaze_direction)
    assert value(report, "gaze_frame") == ("unknown", "unknown")
    assert "in 0% of the sequences" in report.warnings[0]


@pytest.mark.slow
def test_more_sequences_than_the_authors_have_are_read(tmp_path) -> None:
    release = write_release(tmp_path / "ADT", ROWS)
    entries = list(json.loads((release / "target_information.json").read_text("utf-8")).values())
    for index in range(len(ROWS), 25_000):
        for folder in (release / "motions", release / "gazes"):
            os.link(folder / f"{index % len(ROWS):010d}.npy", folder / f"{index:010d}.npy")
    change_targets(release, lambda found: found | {str(k): entries[k % len(ROWS)] for k in range(len(ROWS), 25_000)})
    (report,) = import_release(release, tmp_path / "out", dataset="adt").tables
    assert report.left_out == 0
    assert SequenceTable.open(tmp_path / "out").scalars().num_rows == 25_000
