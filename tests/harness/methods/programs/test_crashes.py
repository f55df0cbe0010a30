"""A program that crashes in mid-run: started once more, then given up with everything kept that was finished."""

from __future__ import annotations

import pytest

from prbench.errors import AdapterError
from prbench.harness.run import run_method
from prbench.harness.run_folder.cost import RunCost
from tests.harness.test_run import reproducible_bytes, request

CRASH = """
if {when}:
    print("CUDA error: an illegal memory access", file=sys.stderr, flush=True)
    open("crashed", "w").close()
    os._exit(134)
"""


def test_one_crash_does_no_harm_and_after_two_on_a_batch_the_same_command_resumes(own, table, tmp_path, monkeypatch):
    own.write()
    monkeypatch.chdir(own.folder)  # where a program of the user's own starts
    run_method(request(table, tmp_path / "whole", own.method))

    own.write(body=CRASH.format(when="header['batch'] == 1 and not os.path.exists('crashed')"))
    run_method(request(table, tmp_path / "once", own.method))
    assert (own.folder / "crashed").exists()
    assert reproducible_bytes(tmp_path / "once") == reproducible_bytes(tmp_path / "whole")
    assert RunCost.read(tmp_path / "once/cost.json").restarts == {"00001": 1}

    (own.folder / "crashed").unlink()
    own.write(body=CRASH.format(when="header['batch'] == 1 or os.path.exists('crashed')"))
    with pytest.raises(AdapterError) as caught:
        run_method(request(table, tmp_path / "twice", own.method))
    message = str(caught.value)
    assert message.startswith("method 'drawn', twice: its program ended with exit status 134")
    assert "It was asked for the batch of 4 sequences from synthetic-adt/rec" in message
    assert message.endswith("    CUDA error: an illegal memory access")
    assert len(list((tmp_path / "twice/predictions").glob("part-*.parquet"))) == 1

    own.write()
    assert run_method(request(table, tmp_path / "twice", own.method)).batches_found == 1
    assert reproducible_bytes(tmp_path / "twice") == reproducible_bytes(tmp_path / "whole")
