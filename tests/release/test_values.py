"""Values are parsed in all forms that occur."""

from __future__ import annotations

import pytest

from prbench.release.values import action_of_text, parse_action, parse_goal, parse_subset


@pytest.mark.parametrize(
    ("text", "action"),
    [
        ("The person picks up a cup.", "pick"), ("A person puts the cup down", "put"), ("someone places it", "put"),
        ("picks/puts an object", None), ("walks around", None), ("she grabbed the pan", "pick"),
        ("returning the bowl", "put"), ("sets down the tray", "put"), ("output device", None),
    ],
)  # fmt: skip
def test_actions_are_read_from_prompts(text, action) -> None:
    assert action_of_text(text) == action


def test_values_in_their_many_forms() -> None:
    assert parse_action("Grab") == "pick"
    assert parse_action(1, "is_put") == "put"
    assert parse_action(0, "pick") == "put"
    assert parse_action(1, "pick_or_put") is None
    assert parse_action(1, "action") is None
    assert parse_subset(1, "is_test") == "test"
    assert parse_subset(False, "train") == "test"
    assert parse_subset(1, "fold") is None
    assert parse_subset("maybe") is None
    for wrong in (None, [1, 2], [1, 2, "x"], [1, 2, float("nan")], "1 2", {"x": 1, "y": 2}, [True, 1, 2], "a b c"):
        assert parse_goal(wrong) is None, wrong
