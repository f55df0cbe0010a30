"""Nightly: each command that writes reads and writes in an object store what it reads and writes on a disk."""

from __future__ import annotations

import io
import json
import os

import pytest

from prbench.object_stores.store import FINISHED, describe
from tests.laws.killed_cases import WRITING, Writing, make_inputs, run
from tests.object_stores.conftest import contents
from tests.object_stores.test_s3 import put_folder

pytestmark = [
    pytest.mark.fuzz,
    pytest.mark.skipif("PRBENCH_FUZZ" not in os.environ, reason="takes minutes: set PRBENCH_FUZZ to run it"),
]

_NATIVE = {"adt", "gimo", "bodiless"}
_ELSEWHERE = {"explain --out", "doctor --out"}
"""Their inputs are named from within a table or a run, which a URL cannot be asked for."""
CASES = [
    writing
    for writing in WRITING
    if not writing.heavy
    and not writing.before
    and not writing.name.startswith("poses")  # which writes beside the videos, on this machine
    and writing.name not in _ELSEWHERE
]


class Url(str):
    """A URL that is put together as paths are."""

    def __truediv__(self, name: str) -> Url:
        return Url(f"{self}/{name}")

    @property
    def parent(self) -> Url:
        return Url(self.rpartition("/")[0])


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    made = make_inputs(tmp_path_factory.mktemp("inputs") / "inputs")
    for folder in made.iterdir():
        if folder.is_dir() and folder.name not in _NATIVE:
            describe(folder)
    return made


@pytest.mark.parametrize("writing", CASES, ids=lambda each: each.name)
def test_a_command_reads_and_writes_there_what_it_does_here(writing: Writing, bucket, here, tmp_path):
    put_folder(here, f"{bucket}/inputs")
    local, remote = tmp_path / "local", tmp_path / "remote"
    for folder in (local, remote):
        folder.mkdir()
    run(local, *writing.words(here, local / writing.result))
    said = io.StringIO()
    out = Url(f"{bucket}/out/{writing.result}")
    run(remote, *writing.words(Url(f"{bucket}/inputs"), out), said=said)
    varies = writing.varies or ("\0",)
    wanted = {name: content for name, content in writing.same(local).items() if (local / name).is_file()}
    found = {
        name: b"" if name.endswith(varies) else content
        for name, content in contents(f"{bucket}/out").items()
        if not name.endswith(FINISHED) and not name.startswith("result/tensorboard/")
    }
    assert sorted(found) == sorted(wanted)
    there = f"{bucket}/inputs".encode()  # reports and shards name what they were given
    renamed = {name: found[name].replace(there, str(here).encode()) for name in found}
    assert [name for name in wanted if _untold(wanted[name]) != _untold(renamed[name])] == []


def _untold(content: bytes) -> object:
    """Return a report without its notes, which say what was fetched; anything else as it is."""
    try:
        report = json.loads(content)
    except ValueError:
        return content
    return {**report, "notes": []} if isinstance(report, dict) and "notes" in report else content
