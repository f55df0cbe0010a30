"""Programs that introduce themselves badly: refused with the reason, never a hang."""

from __future__ import annotations

import re

import pytest

from prbench.errors import AdapterError
from tests.harness.methods.remote.programs import Case, Workshop

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
    Case("negative bytes", "hello(bytes=-1)", "'bytes' is -1, no whole number"),
    Case("bytes as text", "hello(bytes='7')", r"'bytes' is \"7\" \(a string\), no whole number"),
    Case("bytes of null", "hello(bytes=None)", "'bytes' is null, no whole number"),
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
    Case("a true wire", "hello(wire=True)", "version 1 of .* found True. Send the whole number 1."),
    Case("no wire", "hello(wire=None)", "expected version 1 of .* found None. Send the whole number 1."),
    Case("unknown condition", "hello(conditions=['goal'])", r"goal-loc, goal-pose, none, text, found \['goal'\]"),
    Case("conditions as object", "hello(conditions={'goal-loc': 1})", "'conditions' in its hello to be an array of"),
    Case("no condition", "hello(conditions=[])", r"expected 'conditions' to be some of .*found \[\]"),
    Case("nested conditions", "hello(conditions=[['none']])", "expected 'conditions' to be some of"),
    Case("wrong max_frames", "hello(max_frames=0)", "'max_frames' to be a whole number of 1 or more.*found 0"),
    Case("wrong native_fps", "hello(native_fps='30')", "'native_fps' to be frames per second above 0.*found '30'"),
    Case("motionless as number", "hello(motionless=1)", "'motionless' in its hello to be true or false, found 1"),
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
