"""docs/wire-protocol.md says what the code does: constants, keys, columns, and one exchange."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pytest

from prbench.contract import Condition
from prbench.errors import AdapterError
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.harness.methods import messages, process, remote
from prbench.harness.methods.installed import NAME_FORM
from prbench.harness.methods.process import Program
from prbench.harness.methods.remote import RemoteAdapter
from tests.docs.exchange import LISTING, PAGE, Exchange, batch, decoded
from tests.docs.interpreters import EXAMPLES, javascript
from tests.fakes import STANDING
from tests.harness.methods.made_programs import under

TEXT = PAGE.read_text(encoding="utf-8")


def section(title: str) -> str:
    """From one heading to the next of its level or above."""
    level, rest = TEXT.split(f"{title}\n", 1)[0].rpartition("\n")[2], TEXT.split(f"{title}\n", 1)[1]
    return re.split(rf"^#{{1,{len(level.strip())}}} ", rest, maxsplit=1, flags=re.MULTILINE)[0]


def table(title: str, *, which: int = 0) -> list[list[str]]:
    """Cells of a table of a section, without its head."""
    tables = re.findall(r"(?:^\|.*\|\n)+", section(title), re.MULTILINE)
    rows = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in tables[which].splitlines()]
    return rows[2:]


def words(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_limits_and_times_are_those_of_the_code():
    assert TEXT.startswith(f"# The wire protocol, version {messages.WIRE_VERSION}\n")
    limits = {row[0]: row[1:] for row in table("Limits and times")}
    assert limits["header line"][0] == f"{messages.HEADER_LIMIT:,} bytes"
    defaults = Program("x", ("x",), None, ())
    assert limits["time to introduce itself"][0] == f"{defaults.start_timeout:g} s"
    assert limits["time to answer a batch"][0] == f"{defaults.batch_timeout:g} s"
    assert limits["time to exit after the end of stdin"][0] == f"{process.EXIT_SECONDS:g} s"
    assert f"SIGTERM, {process.TERM_SECONDS:g} s later SIGKILL" in limits["time to exit after the end of stdin"][1]
    assert f"| of the method, for tables and run folders; {NAME_FORM};" in section("2. `hello`, program to harness")
    assert f"up to {remote._SHOWN_TEXT:,} characters" in section("2. `hello`, program to harness")
    assert limits["payload of an answer"][0] == "2 × `rows` × (largest `n_frames`) × 66 × 8 bytes + 1 MiB"


def test_joints_and_parents_are_those_of_the_skeleton():
    names = dict(re.findall(r"\| (\d+) ([a-z]+(?: [a-z0-9]+)*)", section("What the numbers mean")))
    assert {int(number): name.replace(" ", "") for number, name in names.items()} == {
        joint.value: joint.name.lower().replace("_", "") for joint in Joint
    }
    assert words(section("What the numbers mean").split("Parents of")[1])[0].split() == [str(p) for p in PARENTS]


@pytest.mark.parametrize("condition", Condition)
def test_columns_of_a_request_are_those_of_the_page(condition):
    asked = under(condition, batch())
    schema = pa.ipc.open_stream(messages.conditions_payload(asked)).schema
    shown = {
        words(name)[0]: words(kind)[0]
        for name, kind, given, _ in table("3. `generate`, harness to program", which=1)
        if given == "always" or condition.value in given.split(", ")
    }
    assert {field.name: _shown_type(field.type) for field in schema} == shown


def _shown_type(kind: pa.DataType) -> str:
    if pa.types.is_fixed_size_list(kind):
        return f"fixed_size_list<{_shown_type(kind.value_type)}>[{kind.list_size}]"
    return {"float": "float32", "double": "float64", "string": "utf8"}.get(str(kind), str(kind))


def test_the_listing_of_the_exchange_is_that_of_its_bytes():
    assert Exchange.shown().listing() == LISTING.read_text(encoding="utf-8")


def test_the_pose_for_methods_that_are_given_no_body_stands_in_the_canonical_frame():
    pose = np.array(json.loads((EXAMPLES / "standing.json").read_text(encoding="utf-8")))
    assert pose.shape == (22, 3)
    np.testing.assert_allclose(pose, STANDING - [0, STANDING[:, 1].min(), 0], atol=1e-9)
    assert pose[0, [0, 2]].tolist() == [0, 0]
    across = pose[2] - pose[1] + pose[17] - pose[16]
    forward = np.cross([0, 1, 0], across)
    np.testing.assert_allclose(forward / np.linalg.norm(forward), [0, 0, 1], atol=1e-9)


def test_the_harness_and_the_example_still_make_the_exchange():
    shown, made = Exchange.shown(), Exchange.made()
    for ours, theirs in ((made.stdin, shown.stdin), (made.stdout, shown.stdout)):
        assert decoded(ours) == decoded(theirs)
    assert {key for key, *_ in decoded(shown.stdin)[0][0].items()} == {
        words(row[0])[0] for row in table("1. `hello`, harness to program")
    }
    assert set(decoded(shown.stdin)[1][0]) == {words(row[0])[0] for row in table("3. `generate`, harness to program")}


def test_javascript_answers_the_exchange_alike(tmp_path):
    shown = Exchange.shown()
    done = subprocess.run(javascript(tmp_path), input=shown.stdin, capture_output=True)
    assert done.returncode == 0, done.stderr
    assert decoded(done.stdout) == decoded(shown.stdout)


BEGINNING = """
import json, os, sys
def hello(**changes):
    json.loads(sys.stdin.buffer.readline())
    header = {"message": "hello", "wire": 1, "name": "made", "version": "1", "conditions": ["goal-loc"], **changes}
    os.write(1, json.dumps(header).encode() + b"\\n")
"""
ENVIRONMENT = tuple(os.environ.items())


def test_the_hello_of_the_harness_has_the_keys_of_the_page(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    script = "import sys; open('hello', 'wb').write(sys.stdin.buffer.readline())"
    (tmp_path / "made.py").write_text(script, encoding="utf-8")
    program = Program("made", (sys.executable, "-S", "-E", "made.py"), tmp_path, ENVIRONMENT)
    with pytest.raises(AdapterError):
        RemoteAdapter.start(program, weights="w", options={"a": "b"}, device="cuda:1", threads=3)
    sent = json.loads((tmp_path / "hello").read_text(encoding="utf-8"))
    rows = {words(key)[0]: kind for key, kind, _ in table("1. `hello`, harness to program")}
    assert set(sent) == set(rows)
    kinds = {"string": str, "integer": int, "object": dict, "string or null": str}
    assert all(isinstance(sent[key], kinds[kind]) for key, kind in rows.items())
    assert (sent["weights"], sent["options"], sent["device"], sent["threads"]) == ("w", {"a": "b"}, "cuda:1", 3)


def test_every_key_of_a_programs_hello_is_honoured(tmp_path, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    keys = {"max_frames": 90, "native_fps": 30.0, "motionless": True, "gaze": True}
    keys |= {"weights": {"goal-loc": {"name": "w", "sha256": "0" * 64}}}
    assert {words(row[0])[0] for row in table("2. `hello`, program to harness") if row[2] == "no"} == set(keys)
    (tmp_path / "made.py").write_text(f"{BEGINNING}\nhello(**{keys!r})\n", encoding="utf-8")
    program = Program("made", (sys.executable, "-S", "-E", "made.py"), tmp_path, ENVIRONMENT)
    adapter = RemoteAdapter.start(program, weights=None, options={}, device="cpu", threads=1)
    adapter.close()
    assert (adapter.max_frames, adapter.native_fps, adapter.motionless, adapter.gaze) == (90, 30.0, True, True)
    assert adapter.weights[Condition.GOAL_LOCATION] == ("w", "0" * 64)
