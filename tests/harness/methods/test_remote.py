"""A program behaves like any other method; one that breaks the protocol is refused with the reason, never a hang."""

from __future__ import annotations

import gc
import re
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from prbench import __version__
from prbench.contract import Adapter, Condition, Cost
from prbench.errors import AdapterError
from prbench.harness.methods.motions import generate_checked
from prbench.harness.methods.process import Fault
from prbench.harness.methods.remote import Introduction, RemoteAdapter, motions_in
from tests.harness.methods.made_programs import (
    HONEST,
    Case,
    Workshop,
    standard_batch,
    standing_motions,
    started,
    with_libraries,
)

BATCH = standard_batch()
EXPECTED = standing_motions(BATCH).ragged()

STANDING = """
import numpy as np, pyarrow as pa
hello()
while True:
    header, payload = read()
    rows = pa.ipc.open_stream(payload).read_next_batch().take(pa.array(range(header["rows"])[::-1]))
    n = rows["n_frames"].to_numpy()
    poses = rows["initial_joints"].flatten().to_numpy().reshape(-1, 66)
    offsets = np.concatenate([[0], np.cumsum(n)]) * 66
    joints = pa.ListArray.from_arrays(pa.array(offsets, pa.int32()), pa.array(np.repeat(poses, n, axis=0).reshape(-1)))
    answer = pa.record_batch([rows["opaque_id"], joints], names=["opaque_id", "joints"])
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, answer.schema) as writer:
        writer.write_batch(answer)
    motions(header, sink.getvalue().to_pybytes())
"""
"""Holds the initial pose still and answers its rows in reverse."""


def test_motions_come_back_in_the_order_of_the_batch_whatever_its_size(workshop: Workshop) -> None:
    adapter = started(with_libraries(workshop.program(STANDING)))
    workshop.started.append(adapter)
    assert isinstance(adapter, Adapter)
    for batch in (BATCH, standard_batch(40), BATCH.rows(1, 2)):
        np.testing.assert_array_equal(adapter.generate(batch, seed=0).ragged(), standing_motions(batch).ragged())


def test_the_program_hears_the_settings_and_the_adapter_what_it_declares(workshop: Workshop) -> None:
    source = """
        header, _ = read()
        write({**INTRODUCTION, "name": "glide", "version": "2", "conditions": ["text", "none"], "max_frames": 99,
               "native_fps": 30, "motionless": True, "unknown": 1,
               "weights": {"text": {"name": "w.npz", "sha256": "0f" * 32}}})
        open("heard.json", "w").write(json.dumps(header))
        read()
    """
    adapter = RemoteAdapter.start(
        workshop.program(source), weights="small", options={"steps": "5"}, device="cuda:1", threads=3
    )
    assert (adapter.name, adapter.version, adapter.max_frames) == ("glide", "2", 99)
    assert (adapter.native_fps, adapter.motionless) == (30.0, True)
    assert adapter.conditions == {Condition.TEXT, Condition.NONE}
    assert adapter.weights == {Condition.TEXT: ("w.npz", "0f" * 32)}
    adapter.close()
    assert (workshop.folder / "heard.json").read_text() == (
        f'{{"message": "hello", "wire": 1, "prbench": "{__version__}", "device": "cuda:1", "threads": 3,'
        ' "options": {"steps": "5"}, "weights": "small"}'
    )


def test_a_payload_behind_a_hello_is_read_and_ignored(workshop: Workshop) -> None:
    adapter = workshop.start("read(); write(INTRODUCTION, b'{further}'); motions(read()[0]); read()")
    np.testing.assert_array_equal(adapter.generate(BATCH, seed=0).ragged(), EXPECTED)


def test_requests_are_numbered_and_say_what_is_asked(workshop: Workshop) -> None:
    source = """
        hello()
        with open("heard.txt", "w") as heard:
            for _ in range(2):
                header, payload = read()
                print(json.dumps(header), len(payload), file=heard)
                motions(header, network_passes=50)
        read()
    """
    adapter = workshop.start(source)
    assert adapter.generate(BATCH, seed=7).cost == Cost(50)
    adapter.generate(BATCH, seed=7)
    adapter.close()
    size = 3168
    assert (workshop.folder / "heard.txt").read_text().splitlines() == [
        f'{{"message": "generate", "batch": {number}, "condition": "goal-loc", "rows": 3, "fps": 20.0, "seed": 7,'
        f' "bytes": {size}}} {size}'
        for number in range(2)
    ]


def test_a_program_that_reports_an_error_is_asked_for_the_next_batch(workshop: Workshop) -> None:
    source = """
        hello()
        header, _ = read()
        write({"message": "error", "batch": 0, "text": "too many goals", "out_of_memory": False})
        header, _ = read()
        write({"message": "error", "batch": 1, "text": "7 GB wanted", "out_of_memory": True})
        motions(read()[0])
        read()
    """
    adapter = workshop.start(source)
    with pytest.raises(AdapterError, match=r"method 'made': its program reported an error: too many"):
        adapter.generate(BATCH, seed=0)
    with pytest.raises(MemoryError, match="7 GB wanted"):
        adapter.generate(BATCH, seed=0)
    np.testing.assert_array_equal(adapter.generate(BATCH, seed=0).ragged(), EXPECTED)


def test_wrong_motions_are_told_by_the_name_of_the_sequence(workshop: Workshop) -> None:
    names = ["adt/a/cup/pick/1", "adt/b/cup/pick/2", "adt/c/cup/put/3"]
    longer = replace(BATCH, n_frames=BATCH.n_frames + 1)
    unknown = replace(BATCH, opaque_id=("a" * 64, *BATCH.opaque_id[1:]))
    adapter = workshop.start(HONEST)
    for batch, says in (
        (longer, "method 'made', sequence adt/a/cup/pick/1: expected 5 frames, found 4"),
        (unknown, r"missing 1 \(adt/a/cup/pick/1\).* sequences from adt/a/cup/pick/1 to adt/c/cup/put/3\."),
    ):
        with pytest.raises(AdapterError, match=says):
            generate_checked(adapter, batch, seed=0, method="made", sequence_ids=names)


def test_closing_ends_the_program_well_and_for_good(workshop: Workshop) -> None:
    adapter = workshop.start(HONEST.replace("while", "import atexit; atexit.register(open, 'ended', 'w')\nwhile"))
    adapter.close()
    adapter.close()
    assert (workshop.folder / "ended").exists(), "it ended by itself, not by a signal"
    assert not workshop.left_behind()
    with pytest.raises(AdapterError, match="asked for motions after its program was closed"):
        adapter.generate(BATCH, seed=0)


def test_what_a_program_still_writes_when_it_is_closed_does_not_hold_it_up(workshop: Workshop) -> None:
    source = """
        hello()
        stdin.read()
        stdout.write(b"x" * 4_000_000)
        stdout.flush()
        open("ended", "w").close()
    """
    workshop.start(source).close()
    assert (workshop.folder / "ended").exists()


def test_a_program_that_nobody_holds_any_more_ends(workshop: Workshop) -> None:
    adapter = started(workshop.program(HONEST))
    assert workshop.left_behind()
    del adapter
    gc.collect()
    assert not workshop.left_behind()


def test_a_program_without_a_folder_starts_in_an_empty_one_that_vanishes(workshop: Workshop) -> None:
    source = "hello(version=os.getcwd().replace(os.sep, '/') + ' ' + str(os.listdir())); read()"
    adapter = started(replace(workshop.program(source), directory=None))
    folder, listing = adapter.version.split(" ")
    adapter.close()
    assert listing == "[]"
    assert "prbench-" in folder
    assert not (workshop.folder / folder).exists()


HALF = "motions(read()[0], None, bytes=len(GOOD)); stdout.write(GOOD[:500]); stdout.flush()"
PROTOCOL = [
    Case(
        "prints before", "print('epoch 1', flush=True); motions(read()[0])", "'epoch 1'. Its stdout belongs to the pro"
    ),
    Case("prints behind the header", "motions(read()[0], None, bytes=8); print('epoch 1')", "payload, found none"),
    Case("garbage for a payload", "motions(read()[0], b'x' * 999)", "expected an Arrow IPC stream as payload, fou"),
    Case("no payload", "motions(read()[0], None)", "answered without a payload"),
    Case("huge payload", "motions(read()[0], None, bytes=2**40)", "payload of 1,099,511,627,776 bytes, where at most"),
    Case("another batch", "motions(read()[0], batch=7)", "answered batch 7, where batch 0 was due"),
    Case("batch as false", "motions(read()[0], batch=False)", "answered batch false, where batch 0 was due"),
    Case("no batch", "motions(read()[0], batch=None)", "answered without the number of a batch, where batch 0 was due"),
    Case(
        "memory as text", "read(); write({'message': 'error', 'out_of_memory': 'yes'})", "'out_of_memory' .yes. .a str"
    ),
    Case("another message", "read(); write({'message': 'hello'})", "answered with the message 'hello', where"),
    Case("wrong passes", "motions(read()[0], network_passes=-4)", "declared -4 network_passes"),
    Case("error", "h, _ = read(); write({'message': 'error', 'batch': 0, 'text': 'no floor'})", "error: no floor. It"),
]
SILENCE = [
    Case("never answers", "read(); time.sleep(60)", "did not answer within 0.4 s. .*lower --batch-size", waits=True),
    Case(
        "dribbles",
        "read()\nwhile True: stdout.write(b' '); stdout.flush(); time.sleep(0.05)",
        "no message: ' +'\\.",
        waits=True,
    ),
    Case(
        "dribbles a header",
        "read(); stdout.write(b'{')\nwhile True: stdout.write(b' '); stdout.flush(); time.sleep(0.05)",
        "did not answer within 0.4 s, after [0-9]+ bytes of a header",
        waits=True,
    ),
    Case(
        "half a payload, then waits",
        f"{HALF}; time.sleep(60)",
        "announced a payload of [0-9,]+ bytes and wrote 500 of them within 0.4 s. 'bytes' has to be the size of",
        waits=True,
    ),
]
CRASHES = [
    Case("half a payload, then exits", HALF, ": its program ended with exit status 0, after 500 of"),
    Case("raises", "read(); sys.exit('IndexError: 7')", r".* status 1\. .*cmd-made-\d+\.log:\n +IndexError: 7"),
    Case("exits well", "read(); sys.exit(0)", ": its program ended with exit status 0. It was .* wrote nothing"),
    Case("closes stdout", "read(); os.close(1); time.sleep(60)", ": its program closed its stdout"),
    Case("is killed", "read(); os.kill(os.getpid(), 9)", r": its program was ended by signal 9 \(SIGKILL; often"),
    Case("128 + signal", "read(); sys.exit(139)", r".* status 139 \(128 \+ 11: SIGSEGV\)"),
]  # fmt: skip


@pytest.mark.parametrize("case", PROTOCOL + SILENCE + CRASHES, ids=lambda case: case.name)
def test_a_bad_answer_is_refused_with_the_batch_and_the_reason(case: Case, workshop: Workshop) -> None:
    if sys.platform == "win32" and "SIG" in case.says:
        pytest.skip("Windows has no signals")
    adapter = workshop.start("hello()\n" + case.source, batch_timeout=0.4 if case.waits else 20.0)
    with pytest.raises(AdapterError) as caught:
        adapter.generate(standard_batch(), seed=0)
    message = str(caught.value)
    assert message.startswith("method 'made'")
    assert f" It was asked for the batch of 3 sequences from {0:064x} to {2:064x}." in message
    found = re.search(case.says, message, re.DOTALL)
    assert found, message
    assert found.start() < message.index(" It was asked for"), "the reason comes first"
    assert not workshop.left_behind() or "error: " in case.says


def test_what_is_printed_behind_an_answer_is_refused_with_the_next_batch(workshop: Workshop) -> None:
    adapter = workshop.start("hello(); motions(read()[0]); print('done', flush=True); read()")
    adapter.generate(standard_batch(), seed=0)
    time.sleep(0.2)
    with pytest.raises(AdapterError, match=r"'done'\. Its stdout belongs to the protocol"):
        adapter.generate(standard_batch(), seed=0)


def test_a_program_that_reads_no_more_is_not_waited_for(workshop: Workshop) -> None:
    adapter = workshop.start("read(); os.close(0); write(INTRODUCTION); time.sleep(60)")
    with pytest.raises(AdapterError, match="its program closed its stdin"):
        adapter.generate(standard_batch(), seed=0)


def test_a_second_answer_to_the_same_batch_is_never_taken_for_the_next(workshop: Workshop) -> None:
    adapter = workshop.start("hello(); h, _ = read(); motions(h); read(); motions(h); read()")
    adapter.generate(standard_batch(), seed=0)
    with pytest.raises(AdapterError, match="answered batch 0, where batch 1 was due"):
        adapter.generate(standard_batch(), seed=0)


def test_a_long_request_to_a_program_that_does_not_read_ends_with_its_time_limit(workshop: Workshop) -> None:
    adapter = workshop.start("hello(); time.sleep(60)", batch_timeout=0.4)
    started = time.monotonic()
    with pytest.raises(AdapterError, match=r"did not answer within 0.4 s \([0-9,]+ of [0-9,]+ bytes of the request"):
        adapter.generate(standard_batch(3000), seed=0)
    assert time.monotonic() - started < 3


STDOUT = "print('Loading weights …', flush=True); hello()"
RAW = "stdout.write({}); stdout.flush(); time.sleep(60)"
LETTERS = [
    Case(
        "prints first", STDOUT, r"is no message: 'Loading weights …'\. Its stdout belongs to the protocol: print to st"
    ),
    Case("prints no line end", RAW.format("b'Loading'"), "is no message: 'Loading'"),
    Case("binary", RAW.format("bytes(range(128, 256)) * 9"), r"is no message: '\\x80\\x81.*'…"),
    Case("endless header", RAW.format("b'{' * 70000"), "bytes without a line end, where a header has at most 65,536"),
    Case("deeply nested", RAW.format("b'{\"a\":' * 9000 + b'\\n'"), "is no message: .*no JSON in UTF-8"),
    Case("no object", RAW.format("b'{\"hello\": 1}\\n'"), "no JSON object with a text under 'message'"),
    Case("no number", RAW.format('b\'{"message": "hello", "wire": NaN}\\n\''), "NaN is no JSON"),
    Case(
        "huge payload", "hello(bytes=10**15)", "announced a payload of 1,000,000,000,000,000 bytes, where at most 1,0"
    ),
    Case(
        "half a header", RAW.format("b'{\"mess'"), "did not answer within 0.4 s, after 6 bytes of a header", waits=True
    ),
    Case("never says hello", "time.sleep(60)", "did not answer within 0.4 s. Let it load its weights with", waits=True),
    Case(
        "exits at once", "sys.exit('no module named jax')", r"ended with exit status 1.*\.log:\n +no module named jax"
    ),
    Case("exits well at once", "sys.exit(0)", "ended with exit status 0. It wrote nothing to its log"),
]
REFUSED = "read(); write({{'message': 'error', 'text': {!r}}})"
CLAIMS = [
    Case("refuses", REFUSED.format("unknown option 'x'."), "its program refused to start: unknown option 'x'.$"),
    Case("refuses without words", REFUSED.format(None), "refused to start: no reason given.$"),
    Case("another message", "read(); write({'message': 'motions'})", "'hello' with 'hello', found the message 'mot"),
    Case("a newer wire", "hello(wire=2)", "expected version 1 of the wire protocol.*found 2. Update prbench."),
    Case("a wire with decimals", "hello(wire=1.0)", "version 1 of .* found 1.0. Send the whole number 1."),
    Case("unknown condition", "hello(conditions=['goal'])", r"goal-loc, goal-pose, none, text, found \['goal'\]"),
    Case("no condition", "hello(conditions=[])", r"expected 'conditions' to be some of .*found \[\]"),
    Case("nested conditions", "hello(conditions=[['none']])", "expected 'conditions' to be some of"),
    Case("wrong max_frames", "hello(max_frames=0)", "'max_frames' to be a whole number of 1 or more.*found 0"),
    Case("endless native_fps", "read(); print(json.dumps({**INTRODUCTION, 'native_fps': 10**400}))", "above 0, or"),
    Case("a reason that is no text", "read(); write({'message': 'error', 'text': 7})", "'text' 7, where a string was"),
    Case("wrong motionless", "hello(motionless='no')", "'motionless' in its hello to be true or false, found 'no'"),
    Case("no name", "hello(name='')", "'name' in its hello to be a text of 1 to 100 characters of .* found ''"),
    Case("a name for terminals", r"hello(name='a\x1b[2J')", r"'name' in its hello .* found 'a\\x1b\[2J'"),
    Case("no version", "hello(version=2)", "'version' in its hello to be a text .* found 2"),
    Case("weights as text", "hello(weights='w.npz')", "'weights' in its hello to give a condition's name and sha256"),
    Case("short digest", "hello(weights={'text': {'name': 'w', 'sha256': 'ff'}})", "64 hexadecimal"),
    Case("weights of what", "hello(weights={'goal': {'name': 'w', 'sha256': 'f' * 64}})", "give a condition's name"),
]  # fmt: skip


@pytest.mark.parametrize("case", LETTERS + CLAIMS, ids=lambda case: case.name)
def test_a_program_that_introduces_itself_badly_is_refused_with_the_reason(case: Case, workshop: Workshop) -> None:
    with pytest.raises(AdapterError) as caught:
        workshop.start(case.source, start_timeout=0.4 if case.waits else 20.0)
    message = str(caught.value)
    assert message.startswith("method 'cmd:made'")
    assert re.search(case.says, message, re.DOTALL), message


def test_what_is_wrong_with_a_hello_is_told_with_the_log(workshop: Workshop) -> None:
    with pytest.raises(AdapterError, match=r"found 'no'\. The end of the log, .*\.log:\n    two lines\n    of advice$"):
        workshop.start("print('two lines\\nof advice', file=sys.stderr); hello(motionless='no'); read()")


def test_a_reason_cannot_play_with_the_terminal(workshop: Workshop) -> None:
    with pytest.raises(
        AdapterError, match="refused to start: a\N{REPLACEMENT CHARACTER}\\[2Jb\nc\N{REPLACEMENT CHARACTER}"
    ):
        workshop.start(r"read(); write({'message': 'error', 'text': 'a\x1b[2Jb\nc\ud800'})")


def test_an_error_may_lack_batch_and_text() -> None:
    with pytest.raises(Fault, match="reported an error: too hot"):
        motions_in({"message": "error", "text": "too hot"}, None, BATCH, 3)
    with pytest.raises(Fault, match="no reason given"):
        motions_in({"message": "error", "batch": 3}, None, BATCH, 3)


@pytest.mark.parametrize(
    "key", ["wire", "name", "version", "conditions", "max_frames", "native_fps", "motionless", "weights"]
)
def test_a_key_of_another_type_is_refused(key: str) -> None:
    right = {"wire": 1, "name": "n", "version": "1", "conditions": ["none"], "max_frames": 9, "native_fps": 30.5}
    right |= {"motionless": True, "weights": {}}
    Introduction.read({"message": "hello", **right}, origin="method 'n'")
    for wrong in ("1", 1.5, True, {"none": 1}, ["none"]):
        if type(wrong) is not type(right[key]) or key == "weights":
            with pytest.raises(AdapterError, match=f"'{key}'"):
                Introduction.read({"message": "hello", **right, key: wrong}, origin="method 'n'")
