"""The same content, written in any shape, under any names and in any form of values, gives the same table."""

from __future__ import annotations

import json

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from prbench.errors import InputFileError, UsageError
from prbench.release import ImportOptions, import_release
from prbench.release.entries import read_entries
from prbench.release.fields import FIELDS
from prbench.release.layout import index_of
from prbench.sequences import SequenceTable
from tests.release.releases import NAMES, SHAPES, Style, plain_entry, rows, write_release

SEQUENCES = rows(5)
ALIASES = {rule.canonical: rule.aliases for rule in FIELDS}
SPELLINGS = {
    "train": ["train", "Train", "training", "tr"],
    "test": ["test", "TEST", "testing", "te"],
}
GOALS = {
    "list": list,
    "nested": lambda goal: [goal],
    "text": lambda goal: " ".join(map(repr, goal)),
    "commas": lambda goal: ", ".join(map(repr, goal)),
    "object": lambda goal: dict(zip("xyz", goal)),
}
KEYS = {
    "ten digits": lambda index: f"{index:010d}",
    "short": str,
    "path": lambda index: f"motions/{index:010d}.npy",
    "word": lambda index: f"seq_{index}",
}
TRUTH_NAMES = {"istrain", "train", "test", "traintest"}


def spelled(alias: str, spelling: int) -> str:
    """An alias as people would write it."""
    return [alias, alias.upper(), "_".join(alias), alias.capitalize() + " "][spelling % 4]


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reference")
    write_release(folder / "release", SEQUENCES)
    report = import_release(folder / "release", folder / "table", dataset="synthetic-adt").reports[0]
    assert report.left_out == 0
    return report.info


@pytest.mark.slow
@settings(max_examples=20, deadline=None, phases=[Phase.explicit, Phase.reuse, Phase.generate])
@given(data=st.data())
def test_shape_names_and_forms_leave_no_trace(data, reference, tmp_path_factory) -> None:
    names = {
        canonical: spelled(
            data.draw(st.sampled_from([a for a in ALIASES[canonical] if a not in TRUTH_NAMES])),
            data.draw(st.integers(0, 3)),
        )
        for canonical in NAMES
    }
    spelling = data.draw(st.integers(0, 3))
    style = Style(
        shape=data.draw(st.sampled_from(sorted(SHAPES))),
        names=names,
        key=KEYS[data.draw(st.sampled_from(sorted(KEYS)))],
        goal=GOALS[data.draw(st.sampled_from(sorted(GOALS)))],
        subset=lambda subset: SPELLINGS[subset][spelling],
        hand=data.draw(st.sampled_from([str, str.upper, lambda hand: hand[0]])),
    )
    folder = tmp_path_factory.mktemp("shape")
    write_release(folder / "release", SEQUENCES, style)
    report = import_release(folder / "release", folder / "table", dataset="synthetic-adt").reports[0]
    assert report.info.identity_digest == reference.identity_digest
    assert report.info.content_digest == reference.content_digest
    assert all(choice.certainty == "certain" for choice in report.fields)


def test_the_order_of_the_entries_leaves_no_trace(reference, tmp_path) -> None:
    path = write_release(tmp_path / "release", SEQUENCES) / "target_information.json"
    entries = json.loads(path.read_text("utf-8"))
    path.write_text(json.dumps(dict(reversed(entries.items()))), encoding="utf-8")
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").reports[0]
    assert report.info.content_digest == reference.content_digest
    ids = SequenceTable.open(tmp_path / "table").scalars()["sequence_id"].to_pylist()
    assert ids == sorted(ids)


@pytest.mark.parametrize("shape", sorted(SHAPES))
def test_every_shape_is_named(shape, tmp_path) -> None:
    write_release(tmp_path / "release", SEQUENCES, Style(shape=shape))
    entries = read_entries(tmp_path / "release" / "target_information.json")
    assert len(entries.entries) == len(SEQUENCES)
    words = {"object": "by sequence", "wrapped": "annotations", "wrapped list": "'data'", "list": "list of entries"}
    word = words[shape] if shape in words else "object " + shape.split(",")[0]
    assert word in entries.shape


@pytest.mark.parametrize("name", ["is_train", "train"])
def test_truth_values_are_read_by_their_name(name, reference, tmp_path) -> None:
    style = Style(names=NAMES | {"subset": name}, subset=lambda subset: subset == "train")
    write_release(tmp_path / "release", SEQUENCES, style)
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").reports[0]
    assert report.info.identity_digest == reference.identity_digest


def test_names_that_only_resemble_are_likely_and_values_alone_assumed(reference, tmp_path) -> None:
    names = NAMES | {"goal": "the goal in m", "primed_frame": "frame of priming", "subset": "fold", "text": "what"}
    write_release(tmp_path / "release", SEQUENCES, Style(names=names))
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").reports[0]
    chosen = {choice.canonical: (choice.field, choice.certainty) for choice in report.fields}
    assert chosen["goal"] == ("the goal in m", "likely")
    assert chosen["primed_frame"] == ("frame of priming", "likely")
    assert chosen["subset"] == ("fold", "assumed")
    assert chosen["text"] == ("what", "assumed")
    assert report.info.content_digest == reference.content_digest


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
    assert report.reports[0].info.options["goal_frame"] == "as the motions"
    assert report.reports[0].unmapped == ("goal_location",)
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
    report = import_release(tmp_path / "release", tmp_path / "table", dataset="synthetic-adt").reports[0]
    assert {choice.canonical: choice.field for choice in report.fields}["source"] == "video"
    assert report.unmapped == ("clip",)


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
        ("[1, 2]", "a int at place 0"),
        ('[{"goal": [1, 2, 3]}]', "a field that names the sequence"),
        ('"text"', "found a str"),
        ("{}", "one sequence or more"),
        ('{"1": 5}', "a int under the key '1'"),
        ("[" * 100_000, "nested lists|valid JSON"),
    ],
)
def test_what_is_no_list_of_sequences_is_refused_with_the_place(content, message, tmp_path) -> None:
    path = tmp_path / "target_information.json"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(InputFileError, match=message):
        read_entries(path)


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
