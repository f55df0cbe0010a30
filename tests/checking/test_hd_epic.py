"""The dataset's own priming beside the rule's, and the funnel beside published counts."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from prbench.checking.hd_epic import JudgedEvent, agreement, published_counts, validate_build, validate_root
from prbench.cli.main import main
from prbench.curation import build_dataset
from prbench.curation.options import NO_OPTIONS, BuildOptions, CurationOptions
from prbench.errors import UsageError
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import refused, reported


def judged(published: str, rule: float | None, prime: float | None = None, *, located: bool = True, action="pick"):
    outcome = "no_location" if not located else "not_primed" if rule is None else "sequence"
    return JudgedEvent(action, 10.0, located, rule, published, prime, outcome)


EVENTS = [
    judged("primed", 6.0, 6.1),
    judged("primed", 4.0, 7.0),
    judged("primed", None, 8.0),
    judged("not_primed", None),
    judged("not_primed", 9.0),
    judged("excluded", 2.0),
    judged("excluded", None),
    judged("not in the file", None, located=False),
]


def test_agreement_by_hand() -> None:
    found = agreement("pick", EVENTS)
    assert (found.events, found.located) == (8, 7)
    assert {(each.published, each.rule): each.events for each in found.counts} == {
        ("primed", "primed"): 2, ("primed", "not_primed"): 1, ("not_primed", "primed"): 1,
        ("not_primed", "not_primed"): 1, ("excluded", "primed"): 1, ("excluded", "not_primed"): 1,
        ("not in the file", "no_location"): 1,
    }  # fmt: skip
    assert found.tested_share == pytest.approx(5 / 7)
    assert found.primed_share == pytest.approx(3 / 5)
    assert found.agreement == pytest.approx(3 / 5)
    assert (found.difference.n, found.difference.bias) == (2, pytest.approx((-0.1 - 3.0) / 2))
    assert (found.published_gaps.n, found.published_gaps.mean) == (3, pytest.approx((3.9 + 3.0 + 2.0) / 3))
    assert (found.rule_gaps.n, found.rule_gaps.mean) == (4, pytest.approx((4 + 6 + 1 + 8) / 4))


def test_the_published_counts_hang_together() -> None:
    known = published_counts()
    assert sum(known.tracks_by_masks) == pytest.approx(known.tracks, abs=20)  # "four or more" counts as more
    assert known.implied_gap == pytest.approx(3.57, abs=0.01)
    assert known.implied_tracks < known.tracks
    assert known.most_places < 2 * known.tracks


@pytest.fixture(scope="module")
def tree(tmp_path_factory) -> Path:
    root = tmp_path_factory.mktemp("copies") / "root"
    synthesize_tree("hd-epic", root, recordings=2, seed=6, n_events=4)
    return root


@pytest.fixture(scope="module")
def tables(tree, tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tables")
    for priming in ("rule", "published"):
        options = BuildOptions(curation=CurationOptions(priming=priming))
        build_dataset("hd-epic", tree, folder / priming, options=options)
    return {priming: folder / priming for priming in ("rule", "published")}


def test_root_and_build_count_the_same(tree, tables) -> None:
    of_root, of_build = validate_root(tree, options=NO_OPTIONS), validate_build(tables["rule"])
    assert of_root.agreements == of_build.agreements
    assert of_root.outcomes == of_build.outcomes
    assert of_root.published_outcomes
    assert sum(of_root.published_outcomes.values()) == sum(of_root.outcomes.values())
    lines = {line.stage: line for line in of_root.funnel}
    assert lines["videos read"].rule == "2"
    assert int(lines["sequences"].rule) <= int(lines["primed"].rule) <= int(lines["with a place"].rule)


def test_nothing_published_stands_beside_invented_videos(tree) -> None:
    validation = validate_root(tree, options=NO_OPTIONS)
    assert validation.synthetic
    assert {line.reference for line in validation.funnel} == {""}
    assert {remark.kind for remark in validation.remarks} == {"measured here"}


def test_a_build_from_published_priming_is_refused(tables) -> None:
    with pytest.raises(UsageError, match="was built with --priming published"):
        validate_build(tables["published"])


def test_the_sample_shows_published_counts_and_says_what_is_a_guess(samples, capsys, tmp_path) -> None:
    assert main(["validate", "hd-epic", "--root", str(samples / "hd-epic"), "--out", str(tmp_path / "v.json")]) == 0
    printed = capsys.readouterr().out
    for text in ("18,134", "18,264", "70.6%", "33.1%", "94.8%", "88.5%", "[known]", "[measured here]", "[guess]"):
        assert text in printed
    content = json.loads((tmp_path / "v.json").read_text())["report"]
    both = content["agreements"][-1]
    assert {"published": "primed", "rule": "primed", "events": 2} in both["counts"]
    assert both["difference"]["largest"] == pytest.approx(0.0026, abs=2e-4)


def test_the_comparison_is_reported(tree, tables, tmp_path, capsys) -> None:
    report = reported(["validate", "hd-epic", "--root", str(tree)], capsys)
    validation = validate_root(tree, options=NO_OPTIONS)
    assert (report.recordings, report.synthetic, report.failed) == (2, True, [])
    assert report.outcomes == dict(validation.outcomes)
    for ours, theirs in zip(report.agreements, validation.agreements, strict=True):
        assert [vars(each) for each in ours.counts] == [vars(each) for each in theirs.counts]
        assert (ours.action, ours.difference.n) == (theirs.action, theirs.difference.n)
    of_table = reported(["validate", "hd-epic", "--data", str(tables["rule"])], capsys)
    assert of_table.agreements == report.agreements
    first = reported(["validate", "hd-epic", "--root", str(tree), "--max-recordings", "1"], capsys)
    assert first.recordings == 1
    words = ["validate", "hd-epic", "--data", str(tables["published"])]
    refused(words, capsys, code=2, message="was built with --priming published")


@pytest.mark.parametrize("words", [[], ["--root", "r", "--data", "d"]])
def test_either_a_copy_or_a_table_is_validated(words, capsys) -> None:
    assert main(["validate", "hd-epic", *words]) == 2
    assert "expected either --root DIR" in capsys.readouterr().err


def test_a_video_that_cannot_be_read_shows_in_the_exit_code(tree, tmp_path, capsys) -> None:
    import shutil

    copy = shutil.copytree(tree, tmp_path / "root")
    next(copy.glob("HD-EPIC/Videos/*/*0000_mp4_to_vrs_time_ns.csv")).unlink()
    assert main(["validate", "hd-epic", "--root", str(copy)]) == 3
    assert "failed: hd-epic_synthetic_seed6_0000" in capsys.readouterr().err
