"""A program that crashes in mid-run: given up with everything kept that was finished."""

from __future__ import annotations

import pytest

from prbench.errors import AdapterError
from prbench.harness.run import run_method
from tests.harness.test_run import reproducible_bytes, request

CRASH = """
if {when}:
    print("CUDA error: an illegal memory access", file=sys.stderr, flush=True)
    os._exit(134)
"""


def test_after_a_crash_the_same_command_resumes(own, table, tmp_path, monkeypatch):
    own.write()
    monkeypatch.chdir(own.folder)  # where a program of the user's own starts
    run_method(request(table, tmp_path / "whole", own.method))

    own.write(body=CRASH.format(when="header['batch'] == 1"))
    with pytest.raises(AdapterError) as caught:
        run_method(request(table, tmp_path / "twice", own.method))
    message = str(caught.value)
    assert message.startswith("method 'drawn': its program ended with exit status 134")
    assert "It was asked for the batch of 4 sequences from synthetic-adt/rec" in message
    assert message.endswith("    CUDA error: an illegal memory access")
    assert len(list((tmp_path / "twice/synthetic-adt/predictions").glob("part-*.parquet"))) == 1

    own.write()
    assert run_method(request(table, tmp_path / "twice", own.method)).batches_found == 1
    assert reproducible_bytes(tmp_path / "twice") == reproducible_bytes(tmp_path / "whole")
