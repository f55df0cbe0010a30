"""Every built-in method, with its bundled weights, passes the checks that methods of others are put through.

Short sequences and short sampling keep this quick; ``prbench adapters check`` asks more (``docs/conformance.md``).
Methods with networks are looked at by the gate.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import msgspec
import pytest

from prbench.checking.conformance.cases import synthetic_cases
from prbench.checking.conformance.findings import CheckRequest, Outcome
from prbench.checking.conformance.session import check
from prbench.checking.conformance.suite import AdapterConformance
from prbench.sequences import SequenceTable
from prbench.sequences.write import write_dataset

pytestmark = pytest.mark.filterwarnings("ignore::prbench.checking.conformance.suite.ConformanceWarning")


@pytest.fixture(scope="module")
def short_sequences(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four sequences of 2.5 to 3.5 seconds, in a table."""
    folder = tmp_path_factory.mktemp("short")
    cases = synthetic_cases(folder, limit=24)
    table = SequenceTable.open(cases.folder)
    chunks = table.chunks(ids=frozenset(cases.source.sequence_ids[:4]))
    write_dataset(
        folder / "short",
        msgspec.structs.replace(
            table.info, file_digests={}, counts=msgspec.structs.replace(table.info.counts, sequences=4)
        ),
        sequences=(chunk.batch for chunk in chunks),
        events=[],
        recordings=table.recordings().to_batches(),
    )
    return folder / "short"


class TestStatic(AdapterConformance):  # learns from training sequences, which are invented if no table is given
    method = "static"


@pytest.mark.slow
class TestMDM(AdapterConformance):
    method = "mdm"
    options: ClassVar = {"sampler": "ddim", "steps": "5"}

    @pytest.fixture(autouse=True)
    def _asked_about(self, short_sequences: Path) -> None:
        type(self).data = short_sequences


NETWORKS = {
    "gmd": {"steps": "2"},
    "dno": {"iterations": "2", "learning-rate": "0.001", "feet": "predicted"},  # Adam and feet amplify rounding
    "dart": {"iterations": "1", "ddim-steps": "2", "guidance": "1"},
    "wandr": {},
    "pr": {"iterations": "2"},
}
"""Options of the other methods with bundled weights."""
FEWEST_PASSED = 15
"""Findings that say "passed"; the others say why a check does not concern the method."""


@pytest.mark.slow
@pytest.mark.parametrize("method", NETWORKS)
def test_methods_with_networks_pass_every_check(method: str, short_sequences: Path) -> None:
    """One test a method, because two processes that share a class's tests would each look at the method."""
    report = check(CheckRequest(method, options=NETWORKS[method], data=short_sequences))
    assert report.failed == ()
    assert sum(finding.outcome is Outcome.PASSED for finding in report.findings) >= FEWEST_PASSED
