"""``prbench study nymeria-table-5``: measured rows beside the printed ones, and refusals."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
import torch

from prbench.cli.main import main
from prbench.representation import decode
from prbench_adapters.training.store import encoded, read_rows
from prbench_adapters.training.weights import write_weights
from prbench_benchmarks.motion_tokens.metrics import error_sums, pooled
from prbench_benchmarks.motion_tokens.network import Tokeniser, TokeniserConfiguration
from prbench_benchmarks.motion_tokens.study import reconstruct
from prbench_benchmarks.motion_tokens.training import TokeniserObjective, TokeniserTraining
from tests.benchmarks.text_to_motion.corpora import made_up_corpus


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return made_up_corpus(tmp_path_factory.mktemp("corpus") / "made-up", n=6)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = Tokeniser(TokeniserConfiguration(width=8, latent=8, codes=16, parts=2)).train()
    network(torch.randn(2, 64, 263))
    return network.eval().requires_grad_(False)


def weights_of(path, network):
    write_weights(path, *TokeniserTraining(network, TokeniserObjective()).weights(), card={})
    return str(path)


def test_a_row_is_the_pooled_error_of_the_test_split(corpus, network, tmp_path, capsys):
    weights = weights_of(tmp_path / "tokens.safetensors", network)
    out = tmp_path / "table.csv"
    given = ["study", "nymeria-table-5", weights, "--data", str(corpus.folder), "--with-published", "--out", str(out)]
    assert main([*given, "--json"]) == 0
    (table,) = json.loads(capsys.readouterr().out)["report"]["tables"]
    measured, printed = table["blocks"]
    (row,) = measured["rows"]
    values = {cell["metric"]: cell["value"] for cell in row["cells"]}
    # The same from the table's own joints.
    sums = []
    used = [set(), set()]
    for clip in (clip for clips in read_rows(corpus, "test") for clip in clips):
        features = encoded(clip.motion, "continuous", name=clip.sequence_id)
        made, tokens = reconstruct(network, features)
        assert len(made) == clip.motion.n_frames // 4 * 4 == 4 * len(tokens)
        sums.append(error_sums(decode(made), clip.motion.joints[: len(made)]))
        for part, chosen in zip(used, tokens.T):
            part.update(chosen.tolist())
    mpjpe, pa_mpjpe, acc = pooled(sums)
    assert [values[name] for name in ("mpjpe", "pa_mpjpe", "acc")] == pytest.approx([mpjpe, pa_mpjpe, acc], rel=1e-3)
    assert values["acc_seconds"] == pytest.approx(values["acc"] * 400 / 1000)
    assert values["dead_codes"] == pytest.approx(100 * (1 - sum(map(len, used)) / 32))
    assert 100 / 16 <= values["codebook_use"] <= 100
    assert {cell["sequences"] for cell in row["cells"]} == {6}
    assert len(printed["rows"]) == 5
    rows = list(csv.DictReader(out.open(encoding="utf-8")))
    best = {row["metric"]: float(row["value"]) for row in rows if row["variant"].endswith("codebook 16384; latent 64")}
    assert best == pytest.approx({"mpjpe": 34.49, "pa_mpjpe": 26.83, "acc": 0.67, "acc_seconds": 2.412})


def test_the_printed_numbers_are_those_of_the_transcript(samples):
    path = samples.parent / "methods" / "paper-tables" / "nymeria_table_5.csv"
    if not path.is_file():
        pytest.skip(f"the transcript to compare with is not there: {path}")
    from prbench.protocol.published import printed_rows

    with path.open(encoding="utf-8") as file:
        expected = [(row["dataset"], row["metric"], float(row["value"])) for row in csv.DictReader(file)]
    names = {"mpjpe": "MPJPE", "pa_mpjpe": "PA-MPJPE", "acc": "ACC"}
    rows = printed_rows("prbench_benchmarks.motion_tokens.published", "tables")
    assert [(row["dataset"], names[key], float(row[key])) for row in rows for key in names] == expected


def test_perfect_reconstruction_has_no_error_and_every_frame_but_the_rest_of_four(network):
    features = np.random.default_rng(0).normal(size=(23, 263)).astype(np.float32)
    made, tokens = reconstruct(network, features)
    again, same = reconstruct(network, features[:20])
    assert made.shape == (20, 263)
    assert np.array_equal(made, again)
    assert np.array_equal(tokens, same)


def test_other_rates_missing_tables_and_unknown_devices_are_refused(corpus, tmp_path, capsys):
    fast = Tokeniser(TokeniserConfiguration(width=4, latent=4, codes=4, fps=30.0))
    weights = weights_of(tmp_path / "fast.safetensors", fast)
    assert main(["study", "nymeria-table-5", weights, "--data", str(corpus.folder)]) != 0
    assert "expected 30 frames per second, as the tokeniser was trained, found 20" in capsys.readouterr().err
    assert main(["study", "nymeria-table-5", weights]) == 2
    assert "--data DIR is needed" in capsys.readouterr().err
    assert main(["study", "nymeria-table-5", weights, "--data", str(corpus.folder), "--device", "abacus"]) != 0
    assert "--device abacus: cannot be used" in capsys.readouterr().err


def test_other_weights_are_refused(corpus, tmp_path, capsys):
    (tmp_path / "pickle.safetensors").write_bytes(b"\x80\x04junk")
    assert main(["study", "nymeria-table-5", str(tmp_path / "pickle.safetensors"), "--data", str(corpus.folder)]) != 0
    assert "pickle" in capsys.readouterr().err
