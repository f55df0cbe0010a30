"""``prbench build-tokens``: what a captioner reads of a corpus, and refusals."""

from __future__ import annotations

import json

import pytest
import torch

from prbench.cli.main import main
from prbench.sequences import CorpusTable
from prbench_adapters.training.store import encoded, read_rows
from prbench_adapters.training.weights import write_weights
from prbench_benchmarks.captions.files import TokensFile
from prbench_benchmarks.motion_tokens import encoding
from prbench_benchmarks.motion_tokens.encoding import joined_texts
from prbench_benchmarks.motion_tokens.network import Tokeniser, TokeniserConfiguration
from prbench_benchmarks.motion_tokens.study import reconstruct
from prbench_benchmarks.motion_tokens.training import TokeniserObjective, TokeniserTraining
from tests.benchmarks.text_to_motion.corpora import made_up_corpus
from tests.fakes import fake_dataset


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return made_up_corpus(tmp_path_factory.mktemp("corpus") / "made-up", n=3)


@pytest.fixture
def build(tmp_path, corpus, capsys):
    """Call the command with some weights; returns exit code, report and message."""

    def called(*data, parts=2, fps=20.0):
        torch.manual_seed(0)
        network = Tokeniser(TokeniserConfiguration(width=8, latent=8, codes=16, parts=parts, fps=fps)).train()
        network(torch.randn(2, 64, 263))
        called.network = network.eval().requires_grad_(False)
        weights = tmp_path / "trained" / "weights.safetensors"
        weights.parent.mkdir(exist_ok=True)
        write_weights(weights, *TokeniserTraining(network, TokeniserObjective()).weights(), card={})
        folders = map(str, data or [corpus.folder])
        words = ["--weights", str(weights.parent), "--data", *folders, "--out", str(tmp_path / "t.parquet")]
        code = main(["build-tokens", *words, "--json"])
        said = capsys.readouterr()
        return code, json.loads(said.out)["report"] if not code else None, said.err

    return called


@pytest.mark.parametrize("parts", [1, 2])
def test_a_captioner_reads_the_tokens_of_whole_motions_with_texts_and_split(parts, build, corpus, tmp_path):
    code, report, _ = build(parts=parts)
    assert (code, report["codes"], report["left_out"]) == (0, 16 * parts, 0)
    assert report["motions"] == 9
    read = TokensFile.read(tmp_path / "t.parquet")
    assert (read.codes, read.dataset, read.licence) == (16 * parts, corpus.info.dataset, corpus.info.licence)
    assert read.synthetic is corpus.info.synthetic
    rows = {row.motion_id: row for row in read.rows}
    for clip in (clip for clips in read_rows(corpus, None) for clip in clips):
        row = rows.pop(clip.sequence_id)
        features = encoded(clip.motion, "continuous", name=clip.sequence_id)
        tokens = reconstruct(build.network, features)[1]
        assert len(row.tokens) == len(features) // 4 * parts
        for part in range(parts):  # neighbours in time stay neighbours, and no id stands for codes of two quantisers
            assert (row.tokens[part::parts] - 16 * part).tolist() == tokens[:, part].tolist()
        assert row.text == clip.texts
        assert f"/{row.split}/" in row.motion_id
    assert not rows


def test_the_same_input_gives_the_same_bytes(build, tmp_path):
    build()
    first = (tmp_path / "t.parquet").read_bytes()
    build()
    assert (tmp_path / "t.parquet").read_bytes() == first


def test_an_annotators_answers_become_one_text_without_the_gaze():
    kinds = ("body posture", "hands/arms motion", "legs/feet motion", "Focus Attention")

    def answers(*texts):
        return [{"text": text, "kind": kind} for text, kind in zip(texts, kinds, strict=True)]

    one, two = answers("Body.", "Arms.", "Legs.", "Eyes."), answers("B.", "A.", "L.", "E.")

    def joined(captions, kind="motion_narration"):
        return joined_texts({"captions": captions, "kind": kind})

    assert joined(one) == ("Body. Arms. Legs.",)
    assert joined([*one, *two]) == ("Body. Arms. Legs.", "B. A. L.")
    assert joined(one[3:]) == ("",)
    assert joined(one[:2], "caption") == ("Body.", "Arms.")


def test_motions_that_cannot_be_encoded_are_counted(build, monkeypatch, tmp_path):
    def one_short(motion, mode, *, name):
        features = encoded(motion, mode, name=name)
        return features[:3] if name.endswith("train/001") else features

    monkeypatch.setattr(encoding, "encoded", one_short)
    assert build()[1]["left_out"] == 1
    assert len(TokensFile.read(tmp_path / "t.parquet").rows) == 8


def test_what_cannot_become_tokens_is_refused_and_nothing_written(build, corpus, tmp_path, monkeypatch):
    fake_dataset(tmp_path / "table", 2)
    again = made_up_corpus(tmp_path / "again", n=3).folder
    rates = CorpusTable.scalars

    def several(self, *, split=None, columns=None):
        found = rates(self, split=split, columns=columns)
        if columns != ["split", "fps"]:
            return found
        return found.set_column(1, "fps", [[20.0, 30.0] + [20.0] * (found.num_rows - 2)])

    for data, fps, message in (
        ((), 30.0, "expected 30 frames per second, as the tokeniser was trained, found 20"),
        ((tmp_path / "table",), 20.0, "expected a built corpus"),
        ((corpus.folder, again), 20.0, "expected every motion once, found some again"),
    ):
        code, _, said = build(*data, fps=fps)
        assert code == 4
        assert message in said
    monkeypatch.setattr(CorpusTable, "scalars", several)
    assert "expected one frame rate, found 20, 30" in build()[2]
    monkeypatch.setattr(CorpusTable, "scalars", rates)
    monkeypatch.setattr(encoding, "joined_texts", lambda *_: ("...",))
    assert "with a text, found none" in build()[2]
    assert not (tmp_path / "t.parquet").exists()
