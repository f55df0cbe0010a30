from __future__ import annotations

from dataclasses import replace

import pytest

from prbench.errors import UsageError
from prbench.sequences.table import table_statistics
from prbench.viewing.distributions import draw_table_one
from tests.fakes import fake_dataset


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_six_panels_have_the_same_bytes_every_time(tmp_path, suffix) -> None:
    statistics = [table_statistics(fake_dataset(tmp_path / name, n=9)) for name in ("one", "two")]
    for name in ("a", "b"):
        draw_table_one(statistics, tmp_path / f"{name}{suffix}")
    first, second = ((tmp_path / f"{name}{suffix}").read_bytes() for name in ("a", "b"))
    assert first == second
    assert first.startswith(b"\x89PNG" if suffix == ".png" else b"<?xml")
    if suffix == ".svg":
        assert all(title in first.decode() for title in ("goal distance", "elevation", "azimuth", "prime gap"))


def test_one_sequence_is_enough(tmp_path) -> None:
    draw_table_one([table_statistics(fake_dataset(tmp_path / "t", n=1))], tmp_path / "one.png")
    assert (tmp_path / "one.png").stat().st_size > 10_000


def test_another_kind_of_file_is_refused_before_anything_is_written(tmp_path) -> None:
    with pytest.raises(UsageError, match=r"\.gif"):
        draw_table_one([table_statistics(fake_dataset(tmp_path / "t", n=2))], tmp_path / "figure.gif")
    assert not (tmp_path / "figure.gif").exists()


def test_a_name_between_dollars_is_no_formula(tmp_path) -> None:
    statistics = table_statistics(fake_dataset(tmp_path / "t", n=2))
    draw_table_one([replace(statistics, dataset="$\\frac$")], tmp_path / "figure.svg")
