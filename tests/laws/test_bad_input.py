"""Bad input is refused with a message that says where, what was expected, what was found and what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.laws import listed
from tests.laws.cases import BadInput

CASES: dict[str, BadInput] = {case.name: case for case in listed("BAD_INPUT")}


@pytest.mark.parametrize("name", list(CASES))
def test_bad_input_is_told(name: str, tmp_path: Path) -> None:
    case = CASES[name]
    with pytest.raises(case.error) as caught:
        case.act(tmp_path)
    message = str(caught.value)
    assert [part for part in case.told if part not in message] == [], message
    assert [path for path in case.unwritten if (tmp_path / path).exists()] == []
