"""Pickled tensors are read; anything that a pickle could run is refused and never run."""

from __future__ import annotations

import io
import os
import pickle
import random
import struct
import sys
import tracemalloc
from collections import Counter

import numpy as np
import pytest
import torch

from prbench.errors import InputFileError
from prbench.readers.gimo import synthetic as tensor_pickles
from prbench.readers.gimo.pickles import load_tensors

TRACE: list[str] = []


def leave_a_trace(*_: object) -> None:
    TRACE.append("run")


class Calls:
    """Pickles as a call of ``function``."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


def _tensors(n: int) -> dict[str, torch.Tensor]:
    """Tensors of many kinds; ``n`` numbers in the longest of them."""
    drawn = torch.randn(n, generator=torch.Generator().manual_seed(n))
    shared = torch.arange(24, dtype=torch.int64)
    return {
        "plain": drawn,
        "double": drawn[:9].clone().double(),
        "half": drawn[:9].clone().half(),
        "bytes": torch.arange(7, dtype=torch.uint8),
        "a part": shared[5:17:3],
        "turned": shared.reshape(4, 6).T,
        "with gradient": torch.nn.Parameter(drawn[:3].clone()),
        "one number": torch.tensor(2.5),
        "empty": torch.zeros(0, 3),
    }


@pytest.mark.parametrize(("n", "protocol"), [(1, 3), (255, 4), (256, 5), (65_535, 4), (65_536, 4)])
def test_a_plain_pickle_holds_the_tensors_that_pickle_reads(tmp_path, n, protocol) -> None:
    path = tmp_path / "0.pkl"
    path.write_bytes(pickle.dumps(_tensors(n), protocol=protocol))
    _require_same(load_tensors(path), pickle.loads(path.read_bytes()))


def _require_same(read: dict[str, np.ndarray], wanted: dict[str, torch.Tensor]) -> None:
    assert list(read) == list(wanted)
    for name, tensor in wanted.items():
        np.testing.assert_array_equal(read[name], tensor.detach().numpy(), strict=True)


def test_damaged_pickles_are_read_or_refused_and_nothing_else(tmp_path) -> None:
    whole = pickle.dumps({"orient": torch.zeros(3), "beta": torch.zeros(1, 10)}, protocol=4)
    drawn = random.Random(7)
    path = tmp_path / "0.pkl"
    refused = 0
    for content in [whole] * 400:
        damaged = bytearray(content)
        for _ in range(drawn.randint(1, 4)):
            damaged[drawn.randrange(len(damaged))] = drawn.randrange(256)
        path.write_bytes(damaged[: drawn.choice([len(damaged), drawn.randrange(len(damaged))])])
        try:
            load_tensors(path)
        except InputFileError:
            refused += 1
    assert 200 < refused < 400


def test_pickles_with_a_fixed_key_are_read_by_pickle_and_by_us(tmp_path) -> None:
    values = {"orient": np.float32([1, 2, 3]), "latent": np.linspace(0, 1, 32, dtype=np.float32)}
    content = tensor_pickles.pickled_tensors(values, requires_grad=("orient",))
    path = tmp_path / "0.pkl"
    path.write_bytes(content)
    for read in (load_tensors(path), {k: v.detach().numpy() for k, v in pickle.loads(content).items()}):
        assert {name: array.tolist() for name, array in read.items()} == {n: a.tolist() for n, a in values.items()}
    assert pickle.loads(content)["orient"].requires_grad


def test_equal_numbers_give_equal_bytes() -> None:
    values = {"trans": np.float32([1, 2, 3])}
    assert tensor_pickles.pickled_tensors(values) == tensor_pickles.pickled_tensors({"trans": values["trans"].copy()})


def _in_a_storage(value: object) -> bytes:
    """A hostile pickle in the place of a tensor's storage."""
    buffer = io.BytesIO()
    torch.save(value, buffer, _use_new_zipfile_serialization=False)
    return pickle.dumps({"orient": Calls(torch.storage._load_from_bytes, buffer.getvalue())})


HOSTILE = {
    "a function of ours": lambda: pickle.dumps({"orient": Calls(leave_a_trace)}),
    "os.system": lambda: pickle.dumps(Calls(os.system, "touch hacked")),
    "eval": lambda: pickle.dumps({"orient": Calls(eval, "TRACE.append('run')")}),
    "exec by the oldest opcodes": lambda: b'c__builtin__\nexec\n(S\'open("hacked","w")\'\ntR.',
    "nested in a list": lambda: pickle.dumps({"trans": [torch.zeros(3), (Calls(leave_a_trace),)]}),
    "inside a storage": lambda: _in_a_storage(Calls(leave_a_trace)),
    "a harmless but foreign class": lambda: pickle.dumps({"orient": Counter("abc")}),
    "an attribute of an allowed module": lambda: b"cnumpy\nload\n(S'hacked'\ntR.",
    "the class of arrays, called": lambda: b"cnumpy\nndarray\n(I3\ntR.",
    "another codec": lambda: pickle.dumps({"a": Calls(__import__("_codecs").encode, "abc", "rot13")}),
}
BUILDS_ON_A_FUNCTION = b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n}X\x06\x00\x00\x00hackedK\x01sb."
"""Python's own unpickler sets an attribute of torch's function with this, though the name is a known one."""

FOREIGN_OPCODES = {
    "PERSID": b"Phacked\n.",
    "INST": b"(inumpy\nndarray\n.",
    "OBJ": b"(ctorch._utils\n_rebuild_tensor_v2\no.",
    "NEWOBJ": b"\x80\x02ccollections\nOrderedDict\n)\x81.",
    "EXT1": b"\x80\x02\x82\x01.",
    "POP": b"N0.",
    "BUILD on a function": BUILDS_ON_A_FUNCTION,
    "BUILD on a dict": b"\x80\x02}}b.",
}


@pytest.mark.parametrize("name", FOREIGN_OPCODES)
def test_an_opcode_that_tensors_do_not_need_is_refused(tmp_path, name) -> None:
    opcode = name.split()[0]
    path = tmp_path / "0.pkl"
    path.write_bytes(FOREIGN_OPCODES[name])
    with pytest.raises(InputFileError, match=f"found the opcode {opcode}. Nothing of it was run"):
        load_tensors(path)
    assert not hasattr(torch._utils._rebuild_tensor_v2, "hacked")


def test_a_name_is_refused_without_importing_its_module(tmp_path) -> None:
    assert "antigravity" not in sys.modules
    path = tmp_path / "0.pkl"
    path.write_bytes(b"cantigravity\nfly\n.")
    with pytest.raises(InputFileError, match=r"found the name 'antigravity\.fly'"):
        load_tensors(path)
    assert "antigravity" not in sys.modules


def _one_storage_many_times() -> bytes:
    buffer = io.BytesIO()
    torch.save(torch.zeros(50_000)._typed_storage(), buffer, _use_new_zipfile_serialization=False)
    raw = buffer.getvalue()
    kept = b"(ctorch.storage\n_load_from_bytes\nq\x00B" + struct.pack("<I", len(raw)) + raw + b"q\x01\x85R"
    return b"\x80\x03" + kept + b"h\x00h\x01\x85R" * 1000 + b"l."


def _one_number_many_times() -> bytes:
    return pickle.dumps({"orient": torch.zeros(1).expand(2**20)}, protocol=4)


BOMBS = {
    "a memo of 2 ** 31 places": (lambda: b"\x80\x02Nr\xff\xff\xff\x7f.", "a NoneType"),
    "a number of 900,000 digits": (lambda: b"I" + b"9" * 900_000 + b"\n.", "Exceeds the limit"),
    "lists 20,000 deep": (lambda: b"]" * 20_000 + b"a" * 19_999 + b".", "a list"),
    "text of 4 GB": (lambda: b"X\xff\xff\xff\xff.", "EOFError"),
    "one storage many times": (_one_storage_many_times, "storages of more than 1,048,576 bytes"),
    "one number many times": (_one_number_many_times, "a tensor of 1048576 numbers in a storage of 1"),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_stays_small(tmp_path, name) -> None:
    make, found = BOMBS[name]
    path = tmp_path / "0.pkl"
    path.write_bytes(make())
    tracemalloc.start()
    try:
        with pytest.raises(InputFileError, match=found):
            load_tensors(path)
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_pickle_is_refused_and_not_run(tmp_path, monkeypatch, name) -> None:
    monkeypatch.chdir(tmp_path)
    TRACE.clear()
    path = tmp_path / "0.pkl"
    path.write_bytes(HOSTILE[name]())
    with pytest.raises(
        InputFileError,
        match=r"expected a pickled dictionary of torch tensors, found (the name|a storage in another form)",
    ) as error:
        load_tensors(path)
    assert "Nothing of it was run" in str(error.value)
    assert TRACE == []
    assert [found.name for found in tmp_path.iterdir()] == ["0.pkl"]


def test_the_hostile_pickles_are_hostile(tmp_path, monkeypatch) -> None:
    """What the tests above refuse would run under plain pickle."""
    monkeypatch.chdir(tmp_path)
    TRACE.clear()
    pickle.loads(HOSTILE["a function of ours"]())
    pickle.loads(HOSTILE["exec by the oldest opcodes"]())
    assert TRACE == ["run"]
    assert (tmp_path / "hacked").exists()
