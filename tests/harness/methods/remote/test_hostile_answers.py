"""Programs that answer a batch badly, or not: an error that names the batch and the reason, never a hang."""

from __future__ import annotations

import re
import sys
import time

import pytest

from prbench.errors import AdapterError
from tests.harness.methods.remote.programs import Case, Workshop, standard_batch

HALF = "motions(read()[0], None, bytes=len(GOOD)); stdout.write(GOOD[:500]); stdout.flush()"
PROTOCOL = [
    Case(
        "prints before", "print('epoch 1', flush=True); motions(read()[0])", "'epoch 1'. Its stdout belongs to the pro"
    ),
    Case("prints behind the header", "motions(read()[0], None, bytes=8); print('epoch 1')", "payload, found none"),
    Case("garbage for a payload", "motions(read()[0], b'x' * 999)", "expected an Arrow IPC stream as payload, fou"),
    Case("empty payload", "motions(read()[0], b'')", "expected an Arrow IPC stream as payload, fou"),
    Case("truncated stream", "motions(read()[0], GOOD[:700])", "expected an Arrow IPC stream as payload, fou"),
    Case("no payload", "motions(read()[0], None)", "answered without a payload"),
    Case("huge payload", "motions(read()[0], None, bytes=2**40)", "payload of 1,099,511,627,776 bytes, where at most"),
    Case("another batch", "motions(read()[0], batch=7)", "answered batch 7, where batch 0 was due"),
    Case("batch as text", "motions(read()[0], batch='0')", r'answered batch "0" \(a string\), where batch 0 was due'),
    Case("batch with decimals", "motions(read()[0], batch=0.0)", "answered batch 0.0 .a number with decimals., where"),
    Case("batch as false", "motions(read()[0], batch=False)", "answered batch false, where batch 0 was due"),
    Case("no batch", "motions(read()[0], batch=None)", "answered without the number of a batch, where batch 0 was due"),
    Case(
        "memory as text", "read(); write({'message': 'error', 'out_of_memory': 'yes'})", "'out_of_memory' .yes. .a str"
    ),
    Case("bytes behind", "motions(read()[0], GOOD + b'abc')", "nothing behind the end of the Arrow stream, found 3 by"),
    Case("an Arrow file", "motions(read()[0], b'ARROW1' + GOOD)", "an Arrow file .* Write the stream format"),
    Case("passes with decimals", "motions(read()[0], network_passes=4.0)", "declared 4.0 .* network_passes"),
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
