"""Finding one sequence by what a person types."""

from __future__ import annotations

import pytest

from prbench.errors import UsageError
from prbench.sequences.lookup import find_sequence_id

IDS = ["adt/rec_1/cup/pick/10.5/suit", "adt/rec_1/cup/put/12.25/suit", "adt/rec_2/cup/pick/10.75/egoallo"]


@pytest.mark.parametrize(
    ("wanted", "found"),
    [(IDS[1], 1), ("egoallo", 2), ("adt/rec_2", 2), ("12.25/suit", 1), ("put", 1), ("pick/10.5/", 0)],
)
def test_an_id_or_a_part_that_fits_one_only(wanted, found):
    assert find_sequence_id(wanted, IDS, among="adt") == IDS[found]


def test_a_beginning_or_end_goes_before_a_part_inside():
    assert find_sequence_id("a", ["a/b", "c/a/d"], among="x") == "a/b"


def test_parts_that_fit_several_are_listed():
    with pytest.raises(UsageError, match=r"'suit' fits 2 sequences of adt(.|\n)*10\.5/suit(.|\n)*12\.25/suit"):
        find_sequence_id("suit", IDS, among="adt")


def test_many_that_fit_are_not_all_listed():
    with pytest.raises(UsageError, match="and 12 more"):
        find_sequence_id("a", [f"a{number}" for number in range(20)], among="x")


def test_an_unknown_id_gets_the_nearest():
    with pytest.raises(UsageError, match=r"no sequence 'put/12\.52'(.|\n)*Near it:\n  adt/rec_1/cup/put/12\.25/suit"):
        find_sequence_id("put/12.52", IDS, among="adt")


def test_nothing_typed_is_nothing_found():
    with pytest.raises(UsageError, match="no sequence ''"):
        find_sequence_id("", IDS, among="adt")
