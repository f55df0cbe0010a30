"""A store in memory for most tests, and a real server that speaks S3 on this machine for the rest."""

from __future__ import annotations

import importlib.util
import logging
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fsspec
import pytest

BUCKET = "bench"


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))


@pytest.fixture
def url() -> str:
    """URL of a folder in memory that nobody has used."""
    return f"memory://bench-{uuid.uuid4().hex}/folder"


@dataclass
class S3:
    """A server of moto in this process, which the commands of other processes reach, too."""

    server: Any
    endpoint: str

    def stop(self) -> None:
        self.server.stop()


@pytest.fixture(scope="session")
def moto_server() -> Iterator[S3]:
    for package in ("s3fs", "moto", "flask_cors"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"{package} is not installed: pip install 'prbench[test]'")
    served = start_moto()
    yield served
    served.stop()


def start_moto() -> S3:
    """Start a server with an empty bucket on a free port of 127.0.0.1."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    return S3(server, f"http://{host}:{port}")


@pytest.fixture
def bucket(moto_server: S3, monkeypatch: pytest.MonkeyPatch) -> str:
    """URL of an empty folder in a bucket of the server."""
    return use_server(moto_server, monkeypatch)


def use_server(served: S3, monkeypatch: pytest.MonkeyPatch) -> str:
    """Point the environment to a server; return the URL of an empty folder there."""
    settings = {
        "AWS_ENDPOINT_URL": served.endpoint,
        "AWS_ACCESS_KEY_ID": "tester",
        "AWS_SECRET_ACCESS_KEY": "not-a-secret",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_MAX_ATTEMPTS": "1",
        "AWS_CONFIG_FILE": "/dev/null",
        "AWS_SHARED_CREDENTIALS_FILE": "/dev/null",
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    system = fsspec.filesystem("s3", skip_instance_cache=True)
    if not system.exists(BUCKET):
        system.mkdir(BUCKET)
    return f"s3://{BUCKET}/{uuid.uuid4().hex}"


def contents(url: str) -> dict[str, bytes]:
    """All objects below a URL, by relative name."""
    system, top = fsspec.url_to_fs(url, skip_instance_cache=True)
    return {path[len(top) :].lstrip("/"): system.cat_file(path) for path in system.find(top)}


def local_contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, by relative name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
