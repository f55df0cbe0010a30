"""The dataset's own priming beside the rule's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from prbench.checking.hd_epic import agreement, validate_build
from prbench.cli.main import main
from prbench.curation import build_dataset
from prbench.curation.options import BuildOptions, CurationOptions
from prbench.errors import UsageError
from prbench.synthetic.write_tree import synthesize_tree
from tests.cli.reports import refused, reported


def judged(published: str | None, rule: float | None, prime: float | None = None, *, located: bool = True):
    return {
        "event_time": 10.0,
        "stage": "priming" if located else "location",
        "prime_time": rule,
        "published_priming": published,
        "published_prime_time": prime,
    }


EVENTS: list[dict[str, Any]] = [
    judged("primed", 6.0, 6.1),
    judged("primed", 4.0, 7.0),
    judged("primed", None, 8.0),
    judged("not_primed", None),
    judged("not_primed", 9.0),
    judged("excluded", 2.0),
    judged("excluded", None),
    judged(None, None, located=False),
]


def test_agreement_by_hand() -> None:
    found = agreement("pick", EVENTS)
    assert (found.events, found.located) == (8, 7)
    assert {name: list(by_rule.values()) for name, by_rule in found.counts.items()} == {
        "primed": [2, 1, 0],
        "not_primed": [1, 1, 0],
        "excluded": [1, 1, 0],
        "not in the file": [0, 0, 1],
    }
    assert found.tested_share == pytest.approx(5 / 7)
    assert found.primed_share == pytest.approx(3 / 5)
    assert found.agreement == pytest.approx(3 / 5)
    assert (found.difference.n, found.difference.bias) == (2, pytest.approx((-0.1 - 3.0) / 2))
    assert found.published_gap[0] == pytest.approx((3.9 + 3.0 + 2.0) / 3)
    assert found.rule_gap[0] == pytest.approx((4 + 6 + 1 + 8) / 4)


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> dict[str, Path]:
    tree = tmp_path_factory.mktemp("copies") / "root"
    synthesize_tree("hd-epic", tree, recordings=2, seed=6, n_events=4)
    folder = tmp_path_factory.mktemp("tables")
    for priming in ("rule", "published"):
        options = BuildOptions(curation=CurationOptions(priming=priming))
        build_dataset("hd-epic", tree, folder / priming, options=options)
    return {priming: folder / priming for priming in ("rule", "published")}


def test_nothing_published_stands_beside_invented_videos(tables) -> None:
    validation = validate_build(tables["rule"])
    assert validation.synthetic
    assert validation.recordings == 2
    assert validation.published_shares == {}
    assert sum(validation.outcomes.values()) == validation.agreements[-1].events


def test_a_build_from_published_priming_is_refused(tables) -> None:
    with pytest.raises(UsageError, match="was built with --priming published"):
        validate_build(tables["published"])


def test_the_sample_shows_published_shares(samples, capsys, tmp_path) -> None:
    build_dataset("hd-epic", samples / "hd-epic", tmp_path / "table")
    words = ["validate", "hd-epic", "--data", str(tmp_path / "table"), "--out", str(tmp_path / "v.json")]
    assert main(words) == 0
    printed = capsys.readouterr().out
    for text in ("70.6%", "33.1%", "94.8%", "88.5%"):
        assert text in printed
    content = json.loads((tmp_path / "v.json").read_text())["report"]
    both = content["agreements"][-1]
    assert both["counts"]["primed"]["primed"] == 2
    assert both["difference"]["largest"] == pytest.approx(0.0026, abs=2e-4)


def test_the_comparison_is_reported(tables, capsys) -> None:
    report = reported(["validate", "hd-epic", "--data", str(tables["rule"])], capsys)
    validation = validate_build(tables["rule"])
    assert (report.recordings, report.synthetic) == (2, True)
    assert report.outcomes == dict(validation.outcomes)
    for ours, theirs in zip(report.agreements, validation.agreements, strict=True):
        assert ours.counts == theirs.counts
        assert (ours.action, ours.difference.n) == (theirs.action, theirs.difference.n)
    words = ["validate", "hd-epic", "--data", str(tables["published"])]
    refused(words, capsys, code=2, message="was built with --priming published")
