"""The clock of motions: what stumbles first, then how fast it runs."""

from __future__ import annotations

from prbench.checking.doctor.clock import examine_clock
from prbench.checking.doctor.frame_rate import examine_frame_rate
from prbench.checking.doctor.patient import Finding, Patient
from prbench.checking.doctor.recorded_clock import examine_recorded_clock


def examine_time(patient: Patient) -> Finding:
    """One diagnosis of the clock: a stumbling clock also changes speeds, and a wrong rate also moves instants."""
    findings = []
    for examine in (examine_clock, examine_recorded_clock):  # what the recording proves outweighs a suspicion
        findings.append(examine(patient))
        if any(diagnosis.certain for diagnosis in findings[-1].diagnoses):
            return findings[-1]
    suspicion = next((finding for finding in findings if finding.diagnoses), Finding((), patient))
    rest = examine_frame_rate(suspicion.patient)
    return Finding((*suspicion.diagnoses, *rest.diagnoses), rest.patient)
