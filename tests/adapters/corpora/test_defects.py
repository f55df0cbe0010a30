"""Every defect of a real copy: what a build makes of it, and what it says."""

from __future__ import annotations

import json
import shutil

import pytest

from prbench.errors import UsageError
from prbench.synthetic.layouts import Defect
from prbench_adapters.corpora.build import build_corpus
from prbench_adapters.corpora.humanml3d.synthetic import DEFECTS as HUMANML3D_DEFECTS
from prbench_adapters.corpora.nymeria.synthetic import DEFECTS as NYMERIA_DEFECTS
from prbench_adapters.corpora.sources import CorpusOptions
from prbench_adapters.corpora.synthetic import synthesize_corpus_tree


def _damaged(tree, tmp_path, defect: Defect):
    copy = tmp_path / "tree"
    shutil.copytree(tree, copy)
    first = next(iter(json.loads((copy / "synthetic.json").read_text())["split"]))
    defect.apply(copy, first)
    return copy, first


def _check(name: str, tree, tmp_path, defect: Defect) -> None:
    copy, first = _damaged(tree, tmp_path, defect)
    (record,) = build_corpus(name, copy, tmp_path / "out", options=CorpusOptions(recordings=first)).records
    assert record.status == defect.outcome, record.message
    assert defect.says in record.message
    if defect.outcome == "read" and not defect.says:
        assert record.outcomes["clip"] > 0


@pytest.mark.parametrize("defect", NYMERIA_DEFECTS, ids=lambda defect: defect.name)
def test_defects_of_nymeria(nymeria_tree, tmp_path, defect):
    _check("nymeria", nymeria_tree, tmp_path, defect)


@pytest.mark.parametrize("defect", HUMANML3D_DEFECTS, ids=lambda defect: defect.name)
def test_defects_of_humanml3d(humanml3d_tree, tmp_path, defect):
    _check("humanml3d", humanml3d_tree, tmp_path, defect)


@pytest.mark.parametrize("name", ["unsorted-rows", "no-byte-order-mark", "nested", "by-group", "repeated-row"])
def test_harmless_defects_change_no_clip(nymeria_tree, tmp_path, name):
    defect = next(each for each in NYMERIA_DEFECTS if each.name == name)
    copy, first = _damaged(nymeria_tree, tmp_path, defect)
    options = CorpusOptions(recordings=first)
    one = build_corpus("nymeria", nymeria_tree, tmp_path / "one", options=options).info
    other = build_corpus("nymeria", copy, tmp_path / "other", options=options).info
    if name == "repeated-row":
        assert other.outcomes["duplicate"] == 1
    if name == "by-group":  # the trajectory stays with the sequence's name
        assert one.counts == other.counts
    assert one.content_digest == other.content_digest


def test_defects_are_done_by_name(tmp_path):
    synthesize_corpus_tree("nymeria", tmp_path / "tree", recordings=1, defects=["missing-suit"])
    assert not list((tmp_path / "tree").glob("*/body/xdata.npz"))
    with pytest.raises(UsageError, match="Did you mean 'missing-suit'"):
        synthesize_corpus_tree("nymeria", tmp_path / "other", recordings=1, defects=["missing-suits"])
    with pytest.raises(UsageError, match="nymeria, humanml3d"):
        synthesize_corpus_tree("motionx", tmp_path / "other", recordings=1)
