"""Names what is wrong with motions from the numbers themselves, with evidence, cause and remedy (docs/doctor.md)."""

from prbench.evaluation.doctor.diagnose import diagnose
from prbench.evaluation.doctor.types import Diagnosis, Expected

__all__ = ["Diagnosis", "Expected", "diagnose"]
