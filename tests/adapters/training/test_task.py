"""The table ``[model]`` is split between networks and objective."""

from __future__ import annotations

import msgspec
import pytest

from prbench.errors import UsageError
from prbench_adapters.training.task import split_model_table


class Networks(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    width: int = 8


class Objective(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    weight: float = 1.0

    def __post_init__(self) -> None:
        if self.weight < 0:
            raise ValueError("'weight' must be at least 0")


def test_each_record_gets_its_own_keys():
    assert split_model_table({"weight": 2.0, "width": 3}, Networks, Objective) == (Networks(3), Objective(2.0))


def test_what_is_not_said_has_its_default():
    assert split_model_table({}, Networks, Objective) == (Networks(), Objective())


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"widht": 3}, "widht"),
        ({"width": "wide"}, r"Expected `int`, got `str` - at `\$\.width`"),
        ({"weight": -1.0}, "'weight' must be at least 0"),
    ],
)
def test_what_describes_nothing_is_refused(wrong, message):
    with pytest.raises(UsageError, match=r"^\[model\]: .*" + message):
        split_model_table(wrong, Networks, Objective)
