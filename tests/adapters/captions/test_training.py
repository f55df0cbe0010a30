"""The captioner learns texts of motion tokens and writes them again."""

import json
import sys

import numpy as np
import pytest
import torch

from prbench.cli import main
from prbench.errors import InputFileError, MissingExtraError, TableError, UsageError
from prbench_adapters.captions import vocabulary
from prbench_adapters.captions.network import Captioner, CaptionerConfiguration
from prbench_adapters.captions.training import CaptionTask, TokensDataset, describe, sources
from prbench_adapters.captions.vocabulary import Words, gpt2, words_of
from prbench_benchmarks.captions.files import read_captions
from tests.benchmarks.captions.test_files import tokens_file

SMALL = {"width": 16, "inner": 16, "layers": 1, "heads": 2, "head_width": 8, "longest": 5}


@pytest.fixture
def tokens(tmp_path):
    return tokens_file(
        tmp_path / "toy.parquet",
        motion_id=list("abcdef"),
        tokens=[[0] * 6, [1, 2, 3], [4, 5], [6], [7, 0], [1]],
        text=[
            ["#C C sits, then stands up again."],
            ["C walks.", "C goes."],
            ["C waits."],
            ["C sits."],
            ["..."],
            ["C walks."],
        ],
        split=["train", "train", "train", "validation", "train", "test"],
    )


def test_words_are_written_again_as_they_stood():
    texts = ["C turns: up, then down.", "C walks, C’s left-hand side tired!"]
    words = Words(words_of(texts))
    assert [words.decode(words.encode(text)) for text in texts] == texts
    assert words.decode(words.encode("C flies up.")) == "C up."  # an unknown word
    assert words.words[:3] == ("<unknown>", ",", "C")


def gpt2_folder(folder):
    """The bytes as GPT-2 writes them, one merge, and the end of text."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    others = [byte for byte in range(256) if byte not in printable]
    signs = {byte: chr(byte) for byte in printable} | {byte: chr(256 + place) for place, byte in enumerate(others)}
    pieces = [*(signs[byte] for byte in range(256)), "th", "<|endoftext|>"]
    folder.mkdir()
    (folder / "vocab.json").write_text(json.dumps({piece: place for place, piece in enumerate(pieces)}))
    (folder / "merges.txt").write_text("#version: 0.2\nt h\n")
    return folder


def test_gpt2s_pieces_are_read_from_a_folder_and_give_any_text_again(tmp_path, monkeypatch):
    monkeypatch.setenv(vocabulary.GPT2_VARIABLE, str(gpt2_folder(tmp_path / "gpt2")))
    found = gpt2()
    text = "C picks up the cup , slowly — é."
    assert len(found) == 258
    assert found.decode(found.encode(text)) == text
    assert 256 in found.encode(text)


def test_missing_files_of_gpt2_are_told_with_the_way_to_get_them(tmp_path, monkeypatch):
    monkeypatch.setenv("HF_HUB_CACHE", str(tmp_path))
    folder = gpt2_folder(tmp_path / "gpt2")
    (folder / "vocab.json").unlink()
    for source in (str(folder), "openai-community/none"):
        monkeypatch.setenv(vocabulary.GPT2_VARIABLE, source)
        with pytest.raises(InputFileError, match=r"expected GPT-2's vocab.json and merges.txt.*hf download"):
            gpt2()
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'prbench\[text\]'"):
        gpt2()


def test_motions_are_framed_cut_and_padded():
    found = sources([np.array([3, 1]), np.arange(7)], 9, 4)
    assert found.tolist() == [[9, 3, 1, 10, 11, 11], [9, 0, 1, 2, 3, 10]]


def test_a_third_of_the_draws_lose_a_token_at_either_end_and_every_text_is_drawn(tokens):
    data = TokensDataset([tokens], split="train", longest=5)
    drawn = [data[1, epoch] for epoch in range(300)]
    lists = [item[0].tolist() for item in drawn]
    assert {tuple(each) for each in lists} == {(1, 2, 3), (2, 3), (1, 2)}
    assert lists.count([1, 2, 3]) / 300 == pytest.approx(2 / 3, abs=0.08)
    assert {text for _, text in drawn} == {"C walks.", "C goes."}
    assert data[0, 0][1] == "C sits, then stands up again."  # the wearer's name
    again = TokensDataset([tokens], split="train", longest=5)[1, 7]
    assert (again[0].tolist(), again[1]) == (lists[7], drawn[7][1])


def test_files_that_do_not_fit_are_refused(tokens, tmp_path):
    other = tokens_file(tmp_path / "other.parquet", codes="9")
    with pytest.raises(UsageError, match="expected 8 codes as in the first, found 9"):
        TokensDataset([tokens, other], split="train", longest=5)
    with pytest.raises(TableError, match=r"expected motions of split 'validation', found none\. The column 'split'"):
        TokensDataset([other], split="validation", longest=5)


def test_the_card_counts_what_was_cut(tokens):
    data = TokensDataset([tokens], split="train", longest=5)
    module = CaptionTask().build(SMALL, data=data, initial=None, stage="train")
    assert module.origin == ("cut at 5: 1 of 4 texts, 1 of 3 motions",)
    assert module.network.configuration.codes == 8


def test_no_padding_reaches_the_loss_or_the_captions(tokens):
    torch.manual_seed(0)
    data = TokensDataset([tokens], split="train", longest=5)
    module = CaptionTask().build(SMALL, data=data, initial=None, stage="train").eval()
    items = [(row.tokens, row.text[0]) for row in data.rows]
    with torch.no_grad():
        together = module(data.collate(items), 0)["loss"]
        alone = sum(module(data.collate([item]), 0)["loss"] for item in items)
    assert together.item() == pytest.approx(alone.item(), rel=1e-5)
    rows = data.rows
    words = module.vocabulary
    written = [
        {row.motion_id: row for row in describe(module.network, words, rows, beam=1, batch_size=n)} for n in (1, 3)
    ]
    assert written[0] == written[1]


def test_a_network_learns_the_texts_of_a_few_motions(tmp_path):
    verbs = ("sits", "walks", "waits", "turns")
    path = tokens_file(
        tmp_path / "x.parquet",
        motion_id=list(verbs),
        tokens=[[place] * 3 for place in range(4)],
        text=[[f"C {verb}, then stands."] for verb in verbs],
    )
    out = tmp_path / "trained"
    overrides = ("training.steps=60", "training.learning_rate=0.01", "model.dropout=0.0", "training.log_every=60")
    words = [word for each in overrides for word in ("--set", each)]
    assert main(["train", "--method", "tm2t", "--config", "smoke", *words, "--data", str(path), "--out", str(out)]) == 0
    for beam in ("1", "2"):
        captions = tmp_path / f"{beam}.jsonl"
        main(["caption", "--weights", str(out), "--tokens", str(path), "--beam", beam, "--out", str(captions)])
        rows = read_captions(captions)
        assert [row.candidate for row in rows] == [row.references[0] for row in rows]
        assert not any(row.cut for row in rows)


def test_the_command_reports_counts_and_refuses_other_codes(tokens, tmp_path, capsys):
    weights, out = tmp_path / "trained", tmp_path / "x.jsonl"
    words = ["--set", "model.longest=5", "--set", "training.steps=2"]
    main(["train", "--method", "tm2t", "--config", "smoke", *words, "--data", str(tokens), "--out", str(weights)])
    capsys.readouterr()
    told = ["caption", "--weights", str(weights), "--out", str(out), "--tokens"]
    assert main([*told, str(tokens), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert {name: report[name] for name in ("motions", "left_out", "cut_motions")} == {
        "motions": 5,
        "left_out": 1,
        "cut_motions": 1,
    }
    assert report["cut_captions"] == sum(row.cut for row in read_captions(out))
    assert [row.motion_id for row in read_captions(out)] == list("abcdf")
    assert main([*told, str(tokens_file(tmp_path / "y.parquet", codes="9"))]) == 4
    assert "expected motions of 8 codes, split 'any', found 2 motions of 9 codes" in capsys.readouterr().err


def test_sizes_that_make_no_network_are_named(tokens):
    data = TokensDataset([tokens], split="train", longest=5)
    for changed, message in (
        ({"width": 15}, "'width' must be even, found 15"),
        ({"depth": 2}, "unknown field `depth`"),
    ):
        with pytest.raises(UsageError, match=message):
            CaptionTask().build(SMALL | changed, data=data, initial=None, stage="train")


def test_the_published_size():
    """10,000 words and 512 codes: embeddings, which the output shares, 4 + 4 layers."""
    shape = CaptionerConfiguration(codes=512, pieces=10_000)
    with torch.device("meta"):
        network = Captioner(shape)
    attention, inner, norm = 4 * (512 * 512 + 512), 2 * 512 * 2048 + 2048 + 512, 2 * 512
    layers = 4 * (3 * attention + 2 * inner + 5 * norm)
    assert sum(each.numel() for each in network.parameters()) == layers + 512 * (515 + 10_003)
