"""A program behaves like any other method: asked, answered, closed."""

from __future__ import annotations

import gc
import time
from dataclasses import replace

import numpy as np
import pytest

from prbench import __version__
from prbench.contract import Adapter, Condition, Cost
from prbench.errors import AdapterError
from prbench.harness.methods.motions import generate_checked
from prbench.harness.methods.remote import RemoteAdapter
from tests.harness.methods.remote.programs import (
    HONEST,
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


def test_a_batch_that_does_not_fit_in_memory_is_asked_for_in_halves(workshop: Workshop) -> None:
    source = STANDING.replace(
        "    rows =",
        """
    if header["rows"] > 1:
        write({"message": "error", "batch": header["batch"], "text": "no memory", "out_of_memory": True})
        continue
    rows =""",
    )
    adapter = started(with_libraries(workshop.program(source)))
    workshop.started.append(adapter)
    motions, halvings = generate_checked(adapter, BATCH, seed=0, method="made", sequence_ids=["a", "b", "c"])
    np.testing.assert_array_equal(motions.ragged(), EXPECTED)
    assert halvings == 2


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


def test_identical_requests_get_identical_bytes(workshop: Workshop) -> None:
    source = """
        hello()
        with open("heard.bin", "wb") as heard:
            for _ in range(2):
                header, payload = read()
                heard.write(payload)
                motions(header)
        read()
    """
    adapter = workshop.start(source)
    for _ in range(2):
        adapter.generate(BATCH, seed=0)
    adapter.close()
    heard = (workshop.folder / "heard.bin").read_bytes()
    assert heard[: len(heard) // 2] == heard[len(heard) // 2 :]


def test_waiting_for_an_answer_costs_no_time_beyond_it(workshop: Workshop) -> None:
    adapter = workshop.start(HONEST)
    adapter.generate(BATCH, seed=0)
    begun = time.perf_counter()
    for _ in range(20):
        adapter.generate(BATCH, seed=0)
    assert time.perf_counter() - begun < 1.0  # 20 answers of 4 kB; a wait in slices would take 4 s
