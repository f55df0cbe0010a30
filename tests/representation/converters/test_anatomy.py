"""The small language of joint maps."""

from __future__ import annotations

import pytest

from prbench.errors import UsageError
from prbench.representation.converters.named_skeletons import parse_expression

KNOWN = ("Hips", "Left Hand", "neck", "head", "j1")


@pytest.mark.parametrize(
    ("text", "joints", "axes"),
    [
        ("neck", (("neck", 1.0),), ()),
        ("neck + head", (("neck", 0.5), ("head", 0.5)), ()),
        ("0.25 neck + .75 head", (("neck", 0.25), ("head", 0.75)), ()),
        ("1.5 neck - 0.5 Hips", (("neck", 1.5), ("Hips", -0.5)), ()),
        ("neck + 0.1 @up - 0.2 @forward", (("neck", 1.0),), (("@up", 0.1), ("@forward", -0.2))),
        ("Left Hand", (("Left Hand", 1.0),), ()),
    ],
)
def test_what_can_be_said(text, joints, axes) -> None:
    read = parse_expression(text, KNOWN, where="map")
    assert (read.joints, read.axes) == (joints, axes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nek", "map: unknown joint 'nek'. Did you mean 'neck'"),
        ("neck + 0.1 @upp", "unknown joint '@upp'. Did you mean '@up'"),
        ("0.5 neck + 0.6 head", r"add up to 1, or of none.*\(1.1 in all\)"),
        ("0.5 neck + head", "weights of all joints"),
        ("neck - head", "weights of all joints"),
        ("0.4 @up", "weights of all joints"),
        ("", "expected joints and numbers"),
        ("3", "expected joints and numbers"),
    ],
)
def test_what_makes_no_sense_is_refused(text, message) -> None:
    with pytest.raises(UsageError, match=message):
        parse_expression(text, KNOWN, where="map")
