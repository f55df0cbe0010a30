"""The same content under any known names, keys and spellings gives the same table."""

from __future__ import annotations

import json

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from prbench.errors import InputFileError, UsageError
from prbench.release.importing import import_release
from prbench.release.layout import index_of, load_known, read_targets
from prbench.release.reading import ImportOptions
from prbench.sequences import SequenceTable
from tests.release.releases import NAMES, Style, plain_entry, rows, write_release

SEQUENCES = rows(5)
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


def spelled(alias: str, spelling: int) -> str:
    """An alias as people would write it."""
    return [alias, alias.upper(), "_".join(alias), alias.capitalize() + " "][spelling % 4]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    write_release(folder / "release", SEQUENCES)
    report = import_release(folder / "release", folder / "table", dataset="synthetic-adt").tables[0]
    assert report.left_out == 0
    return SequenceTable.open(folder / "table").info


@pytest.mark.slow
@settings(max_examples=20, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(data=st.data())
def test_names_keys_and_spellings_leave_no_trace(data, reference, tmp_path_factory) -> None:
    names = {
        canonical: spelled(
            data.draw(st.sampled_from(ALIASES[canonical])),
            data.draw(st.integers(0, 3)),
        )
        for canonical in NAMES
    }
    spelling = data.draw(st.integers(0, 3))
    style = Style(
        names=names,
        key=KEYS[data.draw(st.sampled_from(sorted(KEYS)))],
        subset=lambda subset: SPELLINGS[subset][spelling],
    )
    folder = tmp_path_factory.mktemp("shape")
    write_release(folder / "release", SEQUENCES, style)
    report = import_release(folder / "release", folder / "table", dataset="synthetic-adt").tables[0]
    info = SequenceTable.open(folder / "table").info
    assert info.identity_digest == reference.identity_digest
    assert info.content_digest == reference.content_digest
    assert report.fields == names


def test_the_order_of_the_entries_leaves_no_trace(reference, tmp_path) -> None:
    path = write_release(tmp_path / "release", SEQUENCES) / "target_information.json"
    entries = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps(dict(reversed(entries.items()))), encoding="utf-8")
    import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt")
    assert SequenceTable.open(tmp_path / "table").info.content_digest == reference.content_digest
    ids = SequenceTable.open(tmp_path / "table").scalars()["sequence_id"].to_pylist()
    assert ids == sorted(ids)


def test_two_fields_that_fit_equally_need_the_users_word(tmp_path) -> None:
    def entry(row, style):
        point = row.goal_location.tolist()
        return {
            "goal_location": [0.0, 0.0, 0.0],
            "object_position": point,
            "subset": "train",
            "primed_frame": row.prime_frame,
            "text_prompt": "The person picks an object.",
        }

    write_release(tmp_path / "release", SEQUENCES, entry=entry)
    with pytest.raises(InputFileError, match=r"2: goal_location, object_position\. .*--field-map goal="):
        import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt")
    options = ImportOptions(field_map={"goal": "object_position"})
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt", options=options)
    assert SequenceTable.open(tmp_path / "table").info.options["goal_frame"] == "as the motions"
    assert report.tables[0].fields_kept_in_extra == ["goal_location"]
    for wrong in ({"goal": "nowhere"}, {"gaol": "object_position"}):
        with pytest.raises(UsageError, match="field-map"):
            import_release(
                tmp_path / "release", tmp_path / "t", dataset="synthetic-adt", options=ImportOptions(field_map=wrong)
            )


def test_of_two_names_of_the_source_the_better_known_is_taken(tmp_path) -> None:
    write_release(
        tmp_path / "release",
        SEQUENCES,
        entry=lambda row, style: plain_entry(row, style) | {"clip": "c1", "video": row.recording_id},
    )
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").tables[0]
    assert report.fields["source"] == "video"
    assert report.fields_kept_in_extra == ["clip"]


def test_a_missing_field_is_named_with_those_that_are_there(tmp_path) -> None:
    def entry(row, style):
        return {"goal": row.goal_location.tolist(), "primed_frame": row.prime_frame, "colour": "red"}

    write_release(tmp_path / "release", SEQUENCES, entry=entry)
    with pytest.raises(InputFileError, match="subset: expected a field that fits, found the fields goal, primed_frame"):
        import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt")


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
        ('{"1": {"goal": 1}, "1": {"goal": 2}}', "the key '1' twice"),
        ('{"1": {"goal": 1}, "seq_1": {"goal": 2}}', "'1' and 'seq_1'"),
        ('[{"goal": [1, 2, 3]}]', "one key a sequence, .*found a list"),
        ('"text"', "found a str"),
        ("{}", "one sequence or more"),
        ('{"1": 5}', "a int under the key '1'"),
        ("[" * 100_000, "nested lists|valid JSON"),
    ],
)
def test_what_is_no_object_of_sequences_is_refused_with_the_place(content, message, tmp_path) -> None:
    path = tmp_path / "target_information.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputFileError, match=message):
        read_targets(path)


def test_unrecognised_fields_are_kept_as_text(tmp_path) -> None:
    write_release(
        tmp_path / "release",
        SEQUENCES,
        entry=lambda row, style: plain_entry(row, style) | {"weather": "rain", "shelf": [1, {"a": None}]},
    )
    import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt")
    for chunk in SequenceTable.open(tmp_path / "table").chunks(columns=["extra"]):
        for pairs in chunk.batch.column("extra").to_pylist():
            extra = {pair["key"]: pair["value"] for pair in pairs}
            assert extra["weather"] == "rain"
            assert json.loads(extra["shelf"]) == [1, {"a": None}]
