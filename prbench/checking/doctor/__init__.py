"""Names what is wrong with motions from the numbers themselves, with evidence, cause and remedy (docs/doctor.md)."""

from prbench.checking.doctor.examinations import diagnose
from prbench.checking.doctor.motion_set import Diagnosis, Expected
