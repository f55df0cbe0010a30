"""Every built-in method, with its bundled weights, passes the checks that methods of others are put through.

Short sequences and short sampling keep this quick; ``prbench adapters check`` asks more (``docs/conformance.md``).
Methods with networks are looked at by the gate, all but one of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import pytest

from prbench.checking.conformance.cases import write_sequences
from prbench.checking.conformance.suite import AdapterConformance
from prbench.checking.conformance.synthetic_people import synthetic_sequences

pytestmark = pytest.mark.filterwarnings("ignore::prbench.checking.conformance.suite.ConformanceWarning")


@pytest.fixture(scope="module")
def short_sequences(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four sequences of 2.5 to 3.5 seconds, in a table."""
    shortest = sorted(synthetic_sequences("test", 24), key=lambda sequence: sequence.n_frames)[:4]
    by_id = sorted(shortest, key=lambda sequence: sequence.sequence_id)
    return write_sequences(tmp_path_factory.mktemp("short") / "table", by_id)


class BuiltInConformance(AdapterConformance):
    @pytest.fixture(autouse=True)
    def _asked_about(self, short_sequences: Path) -> None:
        type(self).data = short_sequences


class TestStatic(AdapterConformance):  # learns from training sequences, which are invented if no table is given
    method = "static"


class TestMDM(BuiltInConformance):
    method = "mdm"
    options: ClassVar = {"sampler": "ddim", "steps": "5"}


@pytest.mark.slow
class TestGMD(BuiltInConformance):
    method = "gmd"
    options: ClassVar = {"steps": "2"}


@pytest.mark.slow
class TestDNO(BuiltInConformance):
    method = "dno"
    options: ClassVar = {"iterations": "2"}


@pytest.mark.slow
class TestDartControl(BuiltInConformance):
    method = "dart"
    options: ClassVar = {"iterations": "1", "ddim-steps": "2", "guidance": "1"}


@pytest.mark.slow
class TestWANDR(BuiltInConformance):
    method = "wandr"


@pytest.mark.slow
class TestPR(BuiltInConformance):
    method = "pr"
    options: ClassVar = {"iterations": "2"}
