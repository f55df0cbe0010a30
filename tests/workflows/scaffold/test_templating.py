"""The two marks of templates, and that no template holds one that nothing fills."""

from __future__ import annotations

import itertools
import re

import pytest

from prbench.contract import Condition
from prbench.workflows.scaffold.names import method_names
from prbench.workflows.scaffold.templating import filled
from prbench.workflows.scaffold.values import template_flags, template_values


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ({"a"}, "1\nonly a\nend\n"),
        ({"b"}, "1\nnot a\nend\n"),
        ({"a", "b"}, "1\nonly a\na and b\nend\n"),
    ],
)
def test_parts_are_kept_by_flags(flags, expected):
    template = "1\n%if a\nonly a\n%else\nnot a\n%end\n%if a and b\na and b\n%end\n%if not a and not b\nx\n%end\nend"
    assert filled(template, {}, flags) == expected


def test_values_are_put_in_and_an_empty_one_leaves_no_line():
    assert (
        filled("a <<x>> b\n\n  <<y>>\n<<z>>\nend", {"x": "1", "y": "2\n  3", "z": ""}, ()) == "a 1 b\n\n  2\n  3\nend\n"
    )


def test_a_mark_without_a_value_is_a_mistake():
    with pytest.raises(KeyError, match="unheard"):
        filled("<<unheard>>", {}, ())


def test_flags_say_which_kinds_of_condition_a_method_takes():
    assert template_flags(["none"], trainable=False) == {"free"}
    assert template_flags(["text"], trainable=True) == {"free", "text", "trainable"}
    assert template_flags(["goal-loc"], trainable=False) == {"goal", "goal_location", "text"}
    assert template_flags(["goal-pose", "none"], trainable=False) == {"goal", "goal_pose", "free", "text"}


def test_conditions_are_named_once_and_in_the_given_order():
    values = template_values(method_names("x"), ["text", "none", "text"], trainable=False)
    assert values["conditions"] == "Condition.TEXT, Condition.NONE"
    assert values["condition"] == "text"


def test_values_are_plain_text():
    for chosen in itertools.combinations([condition.value for condition in Condition], 2):
        for value in template_values(method_names("x"), chosen, trainable=True).values():
            assert not re.search(r"<<|^%", value, re.MULTILINE)
