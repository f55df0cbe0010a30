"""What is said where Ray is missing, or no cluster is reached."""

from __future__ import annotations

import socket
import sys

import pytest

from prbench.cli.main import main
from prbench.engine import InProcess, ProcessPool
from prbench.engine.choice import Cluster, open_engine
from prbench.engine.on_ray import RayEngine
from prbench.errors import ClusterError, MissingExtraError


def test_without_ray_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"--engine ray needs .* Run: pip install 'prbench\[ray\]'"):
        list(RayEngine().map(str, range(3)))


def test_without_ray_a_command_ends_before_it_writes(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "ray", None)
    words = ["build-corpus", "synthetic", "--count", "2", "--out", str(tmp_path / "corpus"), "--engine", "ray"]
    assert main(words) == MissingExtraError.exit_code
    assert "pip install 'prbench[ray]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("ray://head:10001", "run the command on a node of the cluster"),
        ("head", "expected HOST:PORT, such as 10.0.0.1:6379, or auto."),
        ("10.0.0.1:70000", "expected HOST:PORT"),
    ],
)
def test_what_is_no_address_is_refused(address, said):
    pytest.importorskip("ray", reason="Ray is not installed")
    with pytest.raises(ClusterError, match=said):
        list(RayEngine(address).map(str, range(3)))


def test_an_address_at_which_nothing_listens_is_refused_at_once():
    pytest.importorskip("ray", reason="Ray is not installed")
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(ClusterError, match=rf"127\.0\.0\.1:{port}: no Ray answers there .* `ray start --head`"):
        list(RayEngine(f"127.0.0.1:{port}").map(str, range(3)))


def test_the_choice_of_an_engine_on_this_machine_is_that_of_its_workers():
    assert open_engine(None) == InProcess()
    assert open_engine(None, usual=2) == ProcessPool(2)
    assert open_engine(3, usual=2) == ProcessPool(3)


@pytest.mark.parametrize("given", [["--address", "auto"], ["--gpus-per-worker", "1"]])
def test_options_of_a_cluster_without_one_are_refused(given, tmp_path, capsys):
    words = ["build-dataset", "adt", "--root", str(tmp_path), "--out", str(tmp_path / "out"), *given]
    assert main(words) == 2
    assert "belong to --engine ray" in capsys.readouterr().err


def test_a_worker_on_a_cluster_occupies_the_processors_of_its_threads():
    engine = open_engine(Cluster(workers=5), threads=4)
    assert isinstance(engine, RayEngine)
    assert engine.workers == 5
    assert (engine.cpus_per_worker, engine.gpus_per_worker) == (4, 0.0)


@pytest.mark.parametrize("command", ["build-dataset", "build-corpus", "build-windows", "run", "score", "train"])
def test_every_command_that_can_be_spread_says_how(command, capsys):
    assert main([command, "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "--engine ray --address 10.0.0.1:6379" in said
    assert "--gpus-per-worker" in said
    assert "--spill-limit" in said
