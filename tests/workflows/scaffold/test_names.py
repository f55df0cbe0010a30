"""Names of new methods: which are refused, and what follows from the others."""

from __future__ import annotations

import keyword

import pytest

from prbench.errors import UsageError
from prbench.workflows.scaffold import names as names_module
from prbench.workflows.scaffold.names import method_names, taken_by


def test_every_other_name_follows_from_the_methods():
    names = method_names("goal-diffusion-2")
    assert (names.distribution, names.module) == ("prbench-goal-diffusion-2", "prbench_goal_diffusion_2")
    assert (names.class_name, names.program) == ("GoalDiffusion2", "goal_diffusion_2")


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
        (
            "static",
            "only prbench itself may use this name. Choose another, such as 'my-static'.",
        ),
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


def test_a_name_that_another_package_offers_is_warned_about(monkeypatch):
    other = names_module.list_adapters()[0].__class__("glide", "other-package", "2.1", "other:load")
    monkeypatch.setattr(names_module, "list_adapters", lambda: [other])
    warning = taken_by(method_names("glide"))
    assert warning is not None
    assert "the installed package other-package 2.1 offers a method 'glide' already" in warning
    assert taken_by(method_names("slide")) is None
