"""docs/wire-protocol.md says what the code does: constants, keys, columns, faults, and one exchange."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from prbench.contract import Condition, ConditionBatch, Motions
from prbench.errors import AdapterError
from prbench.geometry.skeleton import PARENTS, Joint
from prbench.harness.methods import messages, process, remote
from prbench.harness.methods.installed import NAME_FORM
from prbench.harness.methods.motions import generate_checked
from prbench.harness.methods.process import Program
from prbench.harness.methods.remote import RemoteAdapter
from tests.docs.exchange import PAGE, Exchange, batch, decoded, page_with
from tests.docs.interpreters import javascript
from tests.fakes import STANDING

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


# ---------------------------------------------------------------- constants and forms


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
    everything = batch()
    asked = ConditionBatch(
        condition=condition,
        **{name: getattr(everything, name) for name in ("n_frames", "fps", "opaque_id", "noise_seed")},
        **({} if condition == "none" else {"text": everything.text}),
        **({} if condition in ("none", "text") else {"initial_joints": everything.initial_joints}),
        **({} if condition in ("none", "text") else {"previous_joints": everything.previous_joints}),
        **({"goal_location": everything.goal_location} if condition == "goal-loc" else {}),
        **({"goal_joints": everything.initial_joints} if condition == "goal-pose" else {}),
    )
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


@pytest.mark.parametrize(
    ("ids", "kind"),
    [
        (pa.utf8(), pa.list_(pa.float32())),
        (pa.large_utf8(), pa.list_(pa.float64())),
        (pa.utf8(), pa.large_list(pa.float32())),
        (pa.utf8(), pa.list_(pa.list_(pa.float32(), 66))),
        (pa.utf8(), pa.list_(pa.list_(pa.float32()))),
    ],
)
def test_every_form_of_motions_that_the_page_accepts_is_accepted(ids, kind):
    asked = batch()
    motions = [np.stack([STANDING + 0.1 * frame for frame in range(n)]).astype(np.float32) for n in asked.n_frames]
    nested = pa.types.is_nested(kind.value_type)
    rows = [(m.reshape(len(m), 66) if nested else m.reshape(-1)).tolist() for m in motions][::-1]
    columns = {"note": pa.array([1, 2]), "opaque_id": pa.array(asked.opaque_id[::-1], ids)}
    payload = _stream(pa.record_batch({**columns, "joints": pa.array(rows, kind)}))
    found = messages.motions_of(payload, asked)
    assert found.n_frames.tolist() == asked.n_frames.tolist()
    for row, motion in enumerate(motions):
        np.testing.assert_array_equal(found.joints[row, : len(motion)].astype(np.float32), motion)


def _stream(*batches: pa.RecordBatch) -> bytes:
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, batches[0].schema) as writer:
        for rows in batches:
            writer.write_batch(rows)
    return sink.getvalue().to_pybytes()


# ---------------------------------------------------------------- the exchange


def test_the_exchange_on_the_page_is_that_of_the_files():
    assert page_with(Exchange.shown().listing()) == TEXT


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


# ---------------------------------------------------------------- what the harness says

BEGINNING = """
import json, os, signal, sys, time
def read():
    header = json.loads(sys.stdin.buffer.readline())
    sys.stdin.buffer.read(header.get("bytes", 0))
def write(**header):
    os.write(1, json.dumps(header).encode() + b"\\n")
def motions(payload):
    header = {"message": "motions", "batch": 0, "bytes": len(payload)}
    os.write(1, json.dumps(header).encode() + b"\\n" + payload)
    sys.stdin.buffer.read()
def hello(**changes):
    read()
    write(**{"message": "hello", "wire": 1, "name": "made", "version": "1", "conditions": ["goal-loc"], **changes})
"""
ASKED = "hello(); read();"
ASKED_FOR = batch()
ENVIRONMENT = tuple(os.environ.items())
FAULTS = {
    "exits in mid-batch": f"{ASKED} sys.exit(3)",
    "is ended by the system": f"{ASKED} os.kill(os.getpid(), signal.SIGKILL)",
    "closes stdout": f"{ASKED} os.close(1); time.sleep(30)",
    "does not answer": f"{ASKED} time.sleep(30)",
    "prints to stdout": f"{ASKED} print('epoch 1', flush=True); time.sleep(30)",
    "prints after its answer": f"{ASKED} sys.stdout.buffer.write(GOOD + b'done'); sys.stdout.flush(); read()",
    "writes a header that is no JSON": f"{ASKED} print('{{message: 1}}', flush=True); time.sleep(30)",
    "writes a header without its end": f"{ASKED} print('{{' + 70_000 * ' ', flush=True); time.sleep(30)",
    "announces too much": f"{ASKED} write(message='motions', batch=0, bytes=9_000_000_000); time.sleep(30)",
    "answers another batch": f"{ASKED} write(message='motions', batch=7); time.sleep(30)",
    "answers something else": f"{ASKED} write(message='progress', batch=0); time.sleep(30)",
    "answers without a payload": f"{ASKED} write(message='motions', batch=0); time.sleep(30)",
    "answers a batch by another type": f"{ASKED} write(message='motions', batch='0'); time.sleep(30)",
    "answers no batch": f"{ASKED} write(message='motions'); time.sleep(30)",
    "writes a size that is no number": f"{ASKED} write(message='motions', batch=0, bytes=None); time.sleep(30)",
    "announces more than it writes": f"{ASKED} write(message='motions', batch=0, bytes=9); os.write(1, b'no'); read()",
    "sends an Arrow file": f"{ASKED} motions(b'ARROW1' + PAYLOAD)",
    "writes behind the stream in its payload": f"{ASKED} motions(PAYLOAD + b'abc')",
    "sends two record batches": f"{ASKED} motions(TWICE)",
    "leaves out a sequence": f"{ASKED} motions(ONE)",
    "sends integers": f"{ASKED} motions(INTEGERS)",
    "makes another length": f"{ASKED} motions(SHORTER)",
    "makes NaN": f"{ASKED} motions(NAN)",
    "sends what is no Arrow stream": f"{ASKED} write(message='motions', batch=0, bytes=2); os.write(1, b'no'); read()",
    "speaks another version": "hello(wire=2); time.sleep(30)",
    "has no name": "hello(name=None); time.sleep(30)",
    "declares an unknown condition": "hello(conditions=['gaze']); time.sleep(30)",
    "refuses its settings": "read(); write(message='error', text=\"no weights 'x'; there are a and b\")",
    "gives another JSON type in its hello": "hello(motionless=1); time.sleep(30)",
    "gives `wire` with decimals": "hello(wire=1.0); time.sleep(30)",
    "gives `conditions` that are no array": "hello(conditions={'goal-loc': 1}); time.sleep(30)",
    "reports an error": f"{ASKED} write(message='error', batch=0, text='the bowl is too hot'); read()",
}


def test_the_page_lists_these_faults():
    assert {row[0] for row in table("What the harness says")} == set(FAULTS)


@pytest.mark.parametrize(("fault", "said"), table("What the harness says"))
def test_the_harness_says_what_the_page_says(fault, said, tmp_path, monkeypatch):
    if sys.platform == "win32" and "signal" in said:
        pytest.skip("there are no signals on Windows")
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path))
    limit = 1.0 if fault in ("does not answer", "announces more than it writes") else 30.0
    with pytest.raises(AdapterError) as caught:
        _asked_twice(_made(FAULTS[fault], tmp_path, limit))
    assert words(said)[0] in str(caught.value)


def _made(source: str, folder: Path, limit: float = 30.0) -> Program:
    """A program with good and bad payloads at hand."""
    whole = Motions(np.repeat(ASKED_FOR.initial_joints[:, None], 4, axis=1), ASKED_FOR.n_frames)
    shorter = Motions(whole.joints, whole.n_frames - 1)
    spoilt = Motions(np.where(np.arange(4)[:, None, None] == 1, np.nan, whole.joints), whole.n_frames)
    ids, good = ASKED_FOR.opaque_id, messages.motions_payload(ASKED_FOR.opaque_id, whole)
    rows = pa.ipc.open_stream(good).read_next_batch()
    payloads = {
        "PAYLOAD": good,
        "GOOD": b"".join(messages.encode_message({"message": "motions", "batch": 0}, good)),
        "TWICE": _stream(rows, rows),
        "ONE": _stream(rows.slice(0, 1)),
        "INTEGERS": _stream(rows.set_column(1, "joints", pa.array([[1], [2]]))),
        "SHORTER": messages.motions_payload(ids, shorter),
        "NAN": messages.motions_payload(ids, spoilt),
    }
    made = "\n".join([*(f"{name} = {value!r}" for name, value in payloads.items()), BEGINNING, source, ""])
    (folder / "made.py").write_text(made, encoding="utf-8")
    command = (sys.executable, "-S", "-E", str(folder / "made.py"))
    return Program("made", command, folder, ENVIRONMENT, start_timeout=30.0, batch_timeout=limit)


def _asked_twice(program: Program) -> None:
    adapter = RemoteAdapter.start(program, weights=None, options={}, device="cpu", threads=1)
    try:
        for _ in range(2):
            generate_checked(adapter, ASKED_FOR, seed=0, method="made", sequence_ids=ASKED_FOR.opaque_id)
    finally:
        adapter.close()


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
