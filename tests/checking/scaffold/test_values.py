"""Names of new methods: which are refused, and what follows from the others."""

from __future__ import annotations

import keyword

import pytest

from prbench.checking.scaffold.create import ScaffoldRequest, filled, method_names, template_flags, template_values
from prbench.errors import UsageError


def test_every_other_name_follows_from_the_methods():
    names = method_names("goal-diffusion-2")
    assert (names.distribution, names.module) == ("prbench-goal-diffusion-2", "prbench_goal_diffusion_2")
    assert (names.class_name, names.program) == ("GoalDiffusion2Method", "goal_diffusion_2")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("My_Method", "Would 'my-method' do?"),
        ("my method", "Would 'my-method' do?"),
        ("my--method", "Would 'my-method' do?"),
        ("-x-", "Would 'x' do?"),
        ("3d", "beginning with a letter"),
        ("", "beginning with a letter"),
        ("../evil", "beginning with a letter"),
        ("glïde", "beginning with a letter"),
        ("a\nb", "Would 'a-b' do?"),
        ("prbench-glide", "the package is called prbench-NAME by itself. Give 'glide'."),
        ("x" * 41, "expected at most 40 characters, found 41"),
        ("ground-truth", "is a control of prbench"),
        ("shuffled-goal", "is a control of prbench"),
        ("static", "only prbench itself may use this name. Choose another, such as 'my-static'."),
        ("adapters", "is a reserved name"),
        ("data-manifests", "is a reserved name"),
        ("cmd", "is a reserved name"),
        ("nul", "is a reserved name"),
        ("com1", "is a reserved name"),
    ],
)
def test_names_that_cannot_be_used_are_refused_with_one_that_can(name, hint):
    with pytest.raises(UsageError) as caught:
        method_names(name)
    assert hint in str(caught.value)
    assert str(caught.value).startswith(repr(name))


@pytest.mark.parametrize("name", ["none", "true", "condition", "motions", "condition-batch", "path", "exception"])
def test_a_class_never_hides_what_its_file_needs(name):
    made = method_names(name).class_name
    assert made.endswith("Method")
    assert made.isidentifier()
    assert not keyword.iskeyword(made)


@pytest.mark.parametrize(
    ("name", "program"), [("random", "random_method"), ("numpy", "numpy_method"), ("json", "json_method")]
)
def test_a_program_never_hides_a_module_that_it_imports(name, program):
    assert method_names(name).program == program


@pytest.mark.parametrize(
    ("flags", "expected"),
    [({"a"}, "1\nonly a\nend\n"), ({"b"}, "1\nnot a\nend\n"), ({"a", "b"}, "1\nonly a\na and b\nend\n")],
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


def asked(*conditions: str, trainable: bool = False) -> ScaffoldRequest:
    return ScaffoldRequest("x", conditions=conditions, trainable=trainable)


def test_flags_say_which_kinds_of_condition_a_method_takes():
    assert template_flags(asked("none")) == {"free"}
    assert template_flags(asked("text", trainable=True)) == {"free", "text", "trainable"}
    assert template_flags(asked("goal-loc")) == {"goal", "goal_location", "text"}
    assert template_flags(asked("goal-pose", "none")) == {"goal", "goal_pose", "free", "text"}


def test_conditions_are_named_once_and_in_the_given_order():
    values = template_values(method_names("x"), asked("text", "none", "text"))
    assert values["conditions"] == "Condition.TEXT, Condition.NONE"
    assert values["condition"] == "text"
