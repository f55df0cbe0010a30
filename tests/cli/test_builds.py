"""What commands that read recordings say about those that gave nothing."""

from __future__ import annotations

from prbench.cli.builds import print_fruitless
from prbench.sequences import RecordingRecord


def record(name: str, status: str, outcomes: dict[str, int], message: str = "") -> RecordingRecord:
    return RecordingRecord(name, "somebody", "train", name, 60.0, outcomes, status, message)


def test_recordings_that_gave_no_sequence_are_named_with_the_readers_remark(capsys):
    print_fruitless(
        [
            record("blind", "read", {"not_primed": 2}, "no valid gaze, so no event can be primed"),
            record("idle", "read", {}, ""),
            record("fine", "read", {"sequence": 1, "not_primed": 4}, "gaze on half of the frames"),
            record("broken", "failed", {}, "told elsewhere"),
        ]
    )
    assert capsys.readouterr().err.splitlines() == [
        "no sequence: blind, of 2 events: no valid gaze, so no event can be primed",
        "no sequence: idle, of 0 events",
    ]
