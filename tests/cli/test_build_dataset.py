from __future__ import annotations

import pytest

from prbench.cli.build_dataset import _options
from prbench.cli.main import _parser


@pytest.mark.parametrize("words", [["--in-hand", "surface"], ["--occlusion", "mark"]])
def test_what_needs_meshes_asks_the_reader_for_them(words) -> None:
    given = ["build-dataset", "hot3d", "--root", "r", "--out", "o"]
    assert dict(_options(_parser().parse_args([*given, *words])).reader) == {"meshes": "true"}
    assert dict(_options(_parser().parse_args(given)).reader) == {}
