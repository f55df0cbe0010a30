"""``prbench analyse agreement``: on which sequences a run succeeds, printed and as JSON."""

from __future__ import annotations

import json

from prbench.cli import main
from tests.cli.reports import reported
from tests.fakes import fake_dataset


def test_agreement_of_runs_is_printed_and_reported(tmp_path, capsys):
    table = str(fake_dataset(tmp_path / "table", 48).folder)
    run = str(tmp_path / "run")
    words = ["run", "--method", "nearest-neighbour", "--data", table, "--out", run]
    (made,) = reported(words, capsys).runs
    assert main(words) == 0
    assert "agreement with recorded people (phi): Prime Success" in capsys.readouterr().out
    out = tmp_path / "agreement.json"
    rates, by_place = reported(["analyse", "agreement", run, "--data", table, "--out", str(out)], capsys).tables
    assert json.loads(out.read_text())["command"] == "analyse"
    (stored,) = made.agreements
    assert [row.cells[0].value for row in rates.blocks[0].rows] == [rate.phi for rate in stored.rates]
    assert [row.text["sequences"] for row in by_place.blocks[0].rows] == [str(e.sequences) for e in stored.breakdown]
    assert not any("unverified" in note for note in by_place.notes)
    assert main(["analyse", "agreement", run]) == 0
    shown = capsys.readouterr().out
    assert "bearing 30 to 90°" in shown
    assert "height from 1.4 m" in shown
    assert "unverified: its table of synthetic-adt is not at hand" in shown
