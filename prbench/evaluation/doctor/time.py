"""The clock of motions: what stumbles first, then how fast it runs."""

from __future__ import annotations

from prbench.evaluation.doctor.clock import examine_clock
from prbench.evaluation.doctor.frame_rate import examine_frame_rate
from prbench.evaluation.doctor.patient import Finding, Patient
from prbench.evaluation.doctor.recorded_clock import examine_recorded_clock


def examine_time(patient: Patient) -> Finding:
    """One diagnosis of the clock: a stumbling clock also changes speeds, and a wrong rate also moves instants."""
    for examine in (examine_clock, examine_recorded_clock, examine_frame_rate):
        finding = examine(patient)
        if any(diagnosis.certain for diagnosis in finding.diagnoses) or examine is examine_frame_rate:
            return finding
        if finding.diagnoses:
            rest = examine_frame_rate(finding.patient)
            return Finding((*finding.diagnoses, *rest.diagnoses), rest.patient)
    return Finding((), patient)
