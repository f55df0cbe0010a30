"""A Ray cluster in place of a number of processes."""

from __future__ import annotations

import importlib.util
from typing import Any

import pytest

import prbench
from prbench.api.arguments import engine_of, local
from prbench.engine import InProcess, ProcessPool
from prbench.errors import ClusterError, MissingExtraError, UsageError


def test_numbers_are_processes_of_this_machine():
    with engine_of(1) as one, engine_of(3) as three:
        assert one == InProcess()
        assert three == ProcessPool(3)
    with pytest.raises(UsageError, match="workers: expected a whole number of at least 1"), engine_of(0):
        pass
    assert local(3) == 3
    assert local(prbench.Cluster()) == 1


def test_what_is_no_number_of_processes_and_no_cluster_is_named():
    wrong: Any = "4"
    with pytest.raises(UsageError, match=r"expected a number of processes or a prbench\.Cluster, found '4'"):
        local(wrong)
    for name, value in (("workers", 0), ("gpus_per_worker", -1), ("spill_limit", 0)):
        with pytest.raises(UsageError, match=f"{name}: expected"):
            prbench.Cluster(**{name: value})


def test_a_cluster_is_opened_with_what_the_work_needs_and_closed(monkeypatch, tmp_path):
    opened = []

    class Closing:
        def __init__(self, choice, **needs):
            self.choice, self.needs, self.closed = choice, needs, False
            opened.append(self)

        def close(self):
            self.closed = True

    monkeypatch.setattr("prbench.api.arguments.open_engine", Closing)
    cluster = prbench.Cluster("10.0.0.1:6379", workers=8, gpus_per_worker=0.5, spill_limit=2.0)
    with engine_of(cluster, threads=2, reads=(tmp_path,)):
        assert not opened[0].closed
    assert opened[0].closed
    assert opened[0].choice == cluster
    assert opened[0].needs["threads"] == 2
    assert opened[0].needs["reads"] == (tmp_path,)


def test_a_cluster_that_is_not_there_is_named_and_nothing_is_written(table, tmp_path):
    there = importlib.util.find_spec("ray") is not None
    expected = (ClusterError, "no Ray answers there") if there else (MissingExtraError, r"prbench\[ray\]")
    nowhere = prbench.Cluster("127.0.0.1:1")
    with pytest.raises(expected[0], match=expected[1]):
        prbench.run("static", condition="none", data=table, out=tmp_path / "run", workers=nowhere)
    assert list(tmp_path.iterdir()) == []
