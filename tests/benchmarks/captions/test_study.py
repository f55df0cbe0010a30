"""Table 6 in shape: measured rows beside the printed ones, and remarks."""

import json
import sys

import numpy as np
import pytest

from prbench.cli import main
from prbench_benchmarks.captions import metrics
from prbench_benchmarks.captions.files import CaptionRow
from prbench_benchmarks.captions.study import captions_table, score_captions
from tests.benchmarks.captions.test_files import captions_file

# The worked corpus of three pairs, wearers called by several names.
CANDIDATES = ("C picks up the red cup", "#C C walks to the table", "c sits down")
REFERENCES = ("C picks up a red cup slowly", "the wearer walks to the table", "C puts a cup on the table")


def rows(**changed):
    each = zip("abc", CANDIDATES, REFERENCES)
    return [{"motion_id": name, "candidate": text, "references": [other]} | changed for name, text, other in each]


def test_the_worked_corpus_beside_the_printed_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(metrics, "bert_score", lambda *_: (np.array([0.1, 0.2, 0.6]), "a-model"))
    table = captions_table([captions_file(tmp_path, *rows())], with_published=True)
    measured, printed = table.blocks
    found = {cell.metric: cell.value for cell in measured.rows[0].cells}
    wanted = {"bertscore": 30.0, "bleu_1": 54.9743, "bleu_4": 39.3455, "cider_d": 465.6561}
    assert found == pytest.approx(wanted | {"rouge_l": found["rouge_l"], "rouge_l_captioning": 64.8417}, abs=1e-4)
    assert measured.rows[0].text == {"method": "method", "clips": "3"}
    assert [row.text["method"] for row in printed.rows] == ["TM2T", "MotionGPT"]
    assert [cell.value for cell in printed.rows[1].cells] == [14.09, 42.22, 10.31, 37.27, 32.33]
    assert "BERTScore a-model" in " ".join(table.notes)


def test_the_settings_and_their_digest_are_told():
    (remark,) = [each for each in score_captions(worked())[2] if "Digest" in each]
    for part in ("smooth:none", "tok:13a", "ROUGE-L β 1, rouge-score 0", "#C C, #C, the camera wearer", "Digest "):
        assert part in remark


def worked():
    return [
        CaptionRow(motion_id=one["motion_id"], candidate=one["candidate"], references=tuple(one["references"]))
        for one in rows()
    ]


def test_odd_captions_are_counted_and_scored():
    long = " ".join(["word"] * (metrics.LONGEST + 1))
    odd = [
        CaptionRow(motion_id="d", candidate="", references=(long,)),
        CaptionRow(motion_id="e", candidate="?!", references=("C waits.",), cut=True),
    ]
    values, counts, _ = score_captions([*worked(), *odd])
    assert counts == (
        "of 5 motions with 5 references, candidates without letters: 2, longer than 160 words: 1, candidates cut at the"
        " captioner's limit: 1."
    )
    assert values["rouge_l"] == pytest.approx(score_captions(worked())[0]["rouge_l"] * 3 / 5)


def test_the_command_prints_a_dash_and_the_way_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "bert_score", None)
    path = captions_file(tmp_path, *rows())
    out = [str(tmp_path / f"table{suffix}") for suffix in (".csv", ".tex", ".md")]
    assert main(["study", "nymeria-table-6", str(path), "--with-published", "--out", *out, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)["report"]
    assert report["files"] == out
    table = (tmp_path / "table.md").read_text(encoding="utf-8")
    assert "| method | 3 | – | 54.97 |" in table
    assert "| TM2T |  | 11.08 | 40.11 | 8.99 | 20.85 | 30.70 |" in table
    assert r"pip install 'prbench\[bertscore\]'" in table
    assert ",bleu_4,39.345" in (tmp_path / "table.csv").read_text(encoding="utf-8")
    assert "MotionGPT" in (tmp_path / "table.tex").read_text(encoding="utf-8")


def test_a_missing_extra_ends_the_command_with_its_own_code(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "sacrebleu.metrics", None)
    assert main(["study", "nymeria-table-6", str(captions_file(tmp_path, *rows()))]) == 9
    assert "pip install 'prbench[captions]'" in capsys.readouterr().err


def test_settings_that_files_share_are_told_once_and_odd_captions_by_file(tmp_path):
    paths = [captions_file(tmp_path, *rows()), tmp_path / "empty.jsonl"]
    paths[1].write_text(captions_file(tmp_path, *rows(candidate="")).read_text(encoding="utf-8"), encoding="utf-8")
    captions_file(tmp_path, *rows())
    notes = captions_table(paths, with_published=False).notes
    assert sum("Digest" in note for note in notes) == 1
    assert [note.partition(":")[0] for note in notes if "without letters: 3" in note] == ["empty.jsonl"]
