"""The layout of the authors' release: names of folders and fields, keys of entries, and what is no release."""

from __future__ import annotations

import json
import shlex

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from prbench.cli import main
from prbench.errors import InputFileError, UsageError
from prbench.release.layout import dataset_of, folder_of, index_of, load_known, read_targets
from prbench.release.reading import ImportOptions
from tests.release.releases import NAMES, ROWS, Style, change_targets, imported, table_of, write_release

ALIASES = load_known().fields
SPELLINGS = {
    "train": ["train", "Train", "training", " train"],
    "test": ["test", "TEST", "testing", "Test "],
}
KEYS = {
    "ten digits": lambda index: f"{index:010d}",
    "short": str,
    "path": lambda index: f"motions/{index:010d}.npy",
    "word": lambda index: f"seq_{index}",
}


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    assert imported(folder).left_out == 0
    return table_of(folder).info


@pytest.mark.slow
@settings(max_examples=20, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(data=st.data())
def test_names_keys_and_spellings_leave_no_trace(data, reference, tmp_path_factory) -> None:
    names = {}
    for canonical in NAMES:
        alias = data.draw(st.sampled_from(ALIASES[canonical]))
        forms = [alias, alias.upper(), "_".join(alias), alias.capitalize() + " "]
        names[canonical] = data.draw(st.sampled_from(forms))
    spelling = data.draw(st.integers(0, 3))
    style = Style(names, KEYS[data.draw(st.sampled_from(sorted(KEYS)))], subset=lambda name: SPELLINGS[name][spelling])
    folder = tmp_path_factory.mktemp("shape")
    report = imported(folder, style=style)
    info = table_of(folder).info
    assert (info.identity_digest, info.content_digest) == (reference.identity_digest, reference.content_digest)
    assert report.fields == names


def test_the_order_of_the_entries_leaves_no_trace(reference, tmp_path) -> None:
    imported(tmp_path, spoil=lambda release: change_targets(release, lambda found: dict(reversed(found.items()))))
    assert table_of(tmp_path).info.content_digest == reference.content_digest
    ids = table_of(tmp_path).scalars()["sequence_id"].to_pylist()
    assert ids == sorted(ids)


def test_two_fields_that_fit_equally_need_the_users_word(tmp_path) -> None:
    def fields(row):
        return {"goal_location": [0.0, 0.0, 0.0], "object_position": row.goal_location.tolist()}

    with pytest.raises(InputFileError, match=r"found 2: goal_location, object_position\..*--field-map goal="):
        imported(tmp_path / "a", fields=fields)
    options = ImportOptions(field_map={"goal": "object_position"})
    report = imported(tmp_path / "b", fields=fields, options=options)
    assert table_of(tmp_path / "b").info.options["goal_frame"] == "as the motions"
    assert report.fields_kept_in_extra == ["goal_location"]
    with pytest.raises(InputFileError, match="goal: expected the field 'nowhere', found none"):
        imported(tmp_path / "c", fields=fields, options=ImportOptions(field_map={"goal": "nowhere"}))
    with pytest.raises(UsageError, match=r"no field 'gaol'.* Did you mean 'goal'"):
        ImportOptions(field_map={"gaol": "object_position"})


def test_of_two_names_of_the_source_the_better_known_is_taken_and_the_rest_is_kept_as_text(tmp_path) -> None:
    report = imported(
        tmp_path,
        fields=lambda row: {"clip": "c1", "video": row.recording_id, "weather": "rain", "shelf": [1, {"a": None}]},
    )
    assert report.fields["source"] == "video"
    assert sorted(report.fields_kept_in_extra) == ["clip", "shelf", "weather"]
    assert table_of(tmp_path).scalars()["recording_id"].to_pylist() == [row.recording_id for row in ROWS]
    for chunk in table_of(tmp_path).chunks(columns=["extra"]):
        for pairs in chunk.batch.column("extra").to_pylist():
            extra = {pair["key"]: pair["value"] for pair in pairs}
            assert extra["weather"] == "rain"
            assert json.loads(extra["shelf"]) == [1, {"a": None}]


def test_unknown_names_are_asked_for_with_values_and_a_command_that_works(tmp_path, capsys) -> None:
    names = {"goal": "centre of thing", "text": "words", "subset": "fold", "primed_frame": "looked"}
    write_release(tmp_path / "my release" / "ADT", style=Style(names))
    arguments = ["import-release", str(tmp_path / "my release"), "--out", str(tmp_path / "out")]
    assert main(arguments) == 3
    error = capsys.readouterr().err
    for part in ("centre of thing ([", 'words ("The person', 'fold ("t', "looked (40)"):
        assert part in error
    command = error[error.index("prbench import-release") :].strip()
    assert main(shlex.split(command)[1:]) == 0
    assert "centre of thing" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("key", "index"),
    [
        ("0000000012", 12), ("12", 12), ("motions/0000000012.npy", 12), ("seq_12", 12), ("a\\b\\12.npy", 12),
        ("seq_12_end", 12), ("12_b_3", None), ("first", None), ("", None), ("١٢", None), ("../../12", 12),
    ],
)  # fmt: skip
def test_keys_become_numbers(key, index) -> None:
    assert index_of(key) == index


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"a": ', "valid JSON"),
        ('{"1": {"goal": 1}, "1": {"goal": 2}}', "found '1' twice"),
        ('{"1": {"goal": 1}, "seq_1": {"goal": 2}}', "'1' and 'seq_1'"),
        ("[5]", "one key a sequence, .*found a int in a list"),
        ('{"train": {"1": {"goal": 1}}, "test": ["1"]}', "sequence 1: expected one subset, found 'train' and 'test'"),
        ('"text"', "found a str"),
        ("{}", "one sequence or more"),
        ('{"1": 5}', "a int under the key '1'"),
        ("[" * 100_000, "nested|valid JSON"),
    ],
)
def test_what_is_no_object_of_sequences_is_refused_with_the_place(content, message, tmp_path) -> None:
    path = tmp_path / "target_information.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputFileError, match=message):
        read_targets(path, {})


@pytest.mark.parametrize(
    ("folder", "dataset"),
    [
        ("HD-EPIC", "hd-epic"), ("hd_epic", "hd-epic"), ("HDEPIC", "hd-epic"), ("MoGaze", "mogaze"),
        ("synthetic-ADT", "synthetic-adt"), ("motions", None), ("ADT2", None),
    ],
)  # fmt: skip
def test_folders_are_recognised_by_their_letters_and_written_as_the_authors_do(folder, dataset) -> None:
    assert dataset_of(folder) == dataset
    assert [folder_of(name) for name in ("hd-epic", "mogaze", "hot3d", "adt", "gimo", "synthetic-adt", "mine")] == [
        "HD-EPIC", "MoGaze", "HOT3D", "ADT", "GIMO", "ADT", "mine",
    ]  # fmt: skip
