"""The public programs' values of the sample set, worked examples, and laws."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from prbench.errors import MissingExtraError, UnloadableExtraError
from prbench_benchmarks.captions import metrics

PAIR = ("c picks up the red cup", "c picks up a red cup slowly")
THREE = (
    [PAIR[0], "c walks to the table", "c sits down"],
    [[PAIR[1]], ["c walks to the table"], ["c puts a cup on the table"]],
)


@pytest.fixture(scope="module")
def golden(samples):
    return json.loads((samples / "nymeria-tasks" / "text_metrics.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def lower(golden):
    return golden["candidates"], [[text] for text in golden["references"]]


@pytest.fixture(scope="module")
def raw(golden):
    return golden["raw_candidates"], [[text] for text in golden["raw_references"]]


@pytest.mark.parametrize(
    ("name", "tokenizer", "lowercase"),
    [("lower_none", "none", False), ("raw_13a", "13a", False), ("raw_13a_lowercase", "13a", True)],
)
def test_bleu_in_the_three_settings_of_sacrebleu(name, tokenizer, lowercase, golden, lower, raw):
    wanted = golden["sacrebleu"][name]
    pairs = lower if name.startswith("lower") else raw
    settings = {"tokenize": tokenizer, "lowercase": lowercase, "smooth_method": "exp"}
    for order in range(1, 5):
        score, signature = metrics.bleu(*pairs, order, **settings)
        assert score.score == pytest.approx(wanted["bleu_1_to_4"][order - 1], abs=1e-9)
    assert signature == wanted["signature"]
    assert score.precisions == pytest.approx(wanted["precisions"], abs=1e-9)
    found = (score.bp, score.sys_len, score.ref_len)
    assert found == pytest.approx((wanted["brevity_penalty"], wanted["sys_len"], wanted["ref_len"]), abs=1e-9)


def test_bleu_of_the_captioning_programs(golden, lower):
    """Over a corpus their epsilons move it by some 1e-12; of one clip they decide, and are put in here."""
    wanted = golden["captioning"]
    for order in range(1, 5):
        score = metrics.bleu(*lower, order, tokenize="none")[0].score / 100
        assert score == pytest.approx(wanted["bleu_1_to_4"][order - 1], abs=1e-9)
    each = [metrics.bleu([text], [texts], tokenize="none")[0] for text, texts in zip(*lower)]
    counts, totals = (np.array([getattr(one, name) for one in each], dtype=float) for name in ("counts", "totals"))
    precisions = np.cumprod((counts + 1e-15) / (totals + 1e-9), axis=1)
    found = np.array([one.bp for one in each])[:, None] * precisions ** (1 / np.arange(1, 5))
    np.testing.assert_allclose(found.T, wanted["bleu_each"], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("name", "stemmer"), [("plain", False), ("stem", True)])
@pytest.mark.parametrize("kind", ["rouge1", "rouge2", "rougeL"])
def test_rouge_with_and_without_stemming(kind, name, stemmer, golden, raw):
    wanted = golden["rouge_score_precision_recall_f"][name][kind]
    np.testing.assert_allclose(metrics.rouge(*raw, kind, stemmer=stemmer), wanted, rtol=0, atol=1e-9)


def test_rouge_l_and_cider_d_of_the_captioning_programs(golden, lower):
    wanted = golden["captioning"]
    found = [metrics.captioning_rouge_l(*pair) for pair in zip(*lower)]
    np.testing.assert_allclose(found, wanted["rouge_l_each"], rtol=0, atol=1e-9)
    assert np.mean(found) == pytest.approx(wanted["rouge_l"], abs=1e-9)
    found = metrics.cider_d(*lower)
    np.testing.assert_allclose(found, wanted["cider_d_each"], rtol=0, atol=1e-9)
    assert found.mean() == pytest.approx(wanted["cider_d"], abs=1e-9)


def test_two_references_a_clip(golden, lower):
    candidates, texts = lower
    both = [first + second for first, second in zip(texts, texts[1:] + texts[:1])]
    wanted = golden["two_references"]
    np.testing.assert_allclose(metrics.cider_d(candidates, both), wanted["cider_d_each"], rtol=0, atol=1e-9)
    for order in range(1, 5):
        score = metrics.bleu(candidates, both, order, tokenize="none")[0].score / 100
        assert score == pytest.approx(wanted["bleu_1_to_4"][order - 1], abs=1e-9)


def test_the_worked_pair():
    pair = ([PAIR[0]], [[PAIR[1]]])
    assert metrics.bleu(*pair, 1)[0].score == pytest.approx(70.5401, abs=1e-4)
    assert metrics.bleu(*pair, 2)[0].score == pytest.approx(59.8553, abs=1e-4)
    assert metrics.bleu(*pair)[0].score == 0.0  # no smoothing
    assert metrics.bleu(*pair)[1].startswith("nrefs:1|case:mixed|eff:no|tok:13a|smooth:none|version:")
    assert metrics.rouge(*pair)[0] == pytest.approx([5 / 6, 5 / 7, 0.769231], abs=1e-6)
    assert metrics.captioning_rouge_l(PAIR[0], [PAIR[1]]) == pytest.approx(0.758706, abs=1e-6)
    assert metrics.cider_d(*pair) == [0.0]


def test_the_worked_corpus_of_three():
    assert metrics.bleu(*THREE, 1)[0].score == pytest.approx(54.9743, abs=1e-4)
    assert metrics.bleu(*THREE)[0].score == pytest.approx(39.3455, abs=1e-4)
    assert np.mean([metrics.captioning_rouge_l(*pair) for pair in zip(*THREE)]) == pytest.approx(0.648417, abs=1e-6)
    assert metrics.cider_d(*THREE) == pytest.approx([3.969683, 10.0, 0.0], abs=1e-6)


def test_an_empty_answer_scores_nothing():
    candidates, references = ["", *THREE[0][1:]], THREE[1]
    assert metrics.cider_d(candidates, references)[0] == 0.0
    assert metrics.rouge(candidates, references)[0, 2] == 0.0
    assert metrics.captioning_rouge_l("", references[0]) == 0.0
    assert metrics.bleu(candidates, references)[0].score < metrics.bleu(*THREE)[0].score


def test_clips_may_have_different_numbers_of_references():
    references = [[PAIR[1], "c picks up the red cup"], *THREE[1][1:]]
    assert metrics.bleu(THREE[0], references, 1)[0].score > metrics.bleu(*THREE, 1)[0].score
    assert metrics.cider_d(THREE[0], references)[0] > metrics.cider_d(*THREE)[0]
    assert metrics.rouge(THREE[0], references)[0, 2] == 1.0


def test_every_name_of_the_wearer_is_one_and_all_else_stays():
    normalised = metrics.normalised
    assert normalised("#C C opens his box, then the camera wearer sits.") == "C opens his box, then C sits."
    assert normalised("c's cup, a can, Vitamin-Cup and #c") == "C's cup, a can, Vitamin-Cup and C"


@pytest.mark.parametrize(
    ("module", "call", "extra"),
    [
        ("sacrebleu.metrics", metrics.bleu, "captions"),
        ("rouge_score.rouge_scorer", metrics.rouge, "captions"),
        ("bert_score", metrics.bert_score, "bertscore"),
    ],
)
def test_a_missing_package_is_named_with_what_installs_it(module, call, extra, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf"pip install 'prbench\[{extra}\]'"):
        call(*THREE)


def fake_bert_score(monkeypatch, scorer):
    monkeypatch.setitem(sys.modules, "bert_score", SimpleNamespace(BERTScorer=scorer))


def test_bert_score_weighs_by_all_references_and_rescales(monkeypatch):
    class Scorer:
        hash = "a-model_L17_idf-rescaled"
        baseline_vals = (0.7, 0.7, 0.8)

        def __init__(self, **settings):
            assert settings.pop("idf_sents") == [PAIR[1], "c walks to the table", "c puts a cup on the table"]
            assert settings == {"lang": "en", "idf": True, "rescale_with_baseline": True}

        def score(self, candidates, references):
            assert (candidates, references) == ([PAIR[0], "c sits down"], [THREE[1][0], THREE[1][2]])
            return [SimpleNamespace(numpy=lambda value=value: np.array([value, 1.0])) for value in (0.1, 0.2, 0.3)]

    fake_bert_score(monkeypatch, Scorer)
    found, name = metrics.bert_score([PAIR[0], " ", "c sits down"], THREE[1])
    assert found == pytest.approx([0.3, -4.0, 1.0])  # an empty candidate: a raw 0
    assert name == Scorer.hash


def test_a_model_that_cannot_be_loaded_is_one_message(monkeypatch):
    def offline(**_):
        raise OSError("no connection to the hub\nand more")

    fake_bert_score(monkeypatch, offline)
    with pytest.raises(UnloadableExtraError, match=r"no connection to the hub\. Load its model once"):
        metrics.bert_score(*THREE)
