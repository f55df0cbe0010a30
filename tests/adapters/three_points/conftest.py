"""Tracks of four synthetic people, one of whom is in the test split."""

import pytest

from prbench.cli import main
from tests.shared import made_once


@pytest.fixture(scope="session")
def tracks():
    def make(out):
        main(["synthesize", "nymeria", "--count", "4", "--seed", "11", "--out", str(out / "tree")])
        main(
            ["build-tracks", "nymeria", "--root", str(out / "tree"), "--devices", "synthetic", "--out", str(out / "t")]
        )

    return made_once("three-points-tracks", make) / "t"
