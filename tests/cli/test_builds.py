"""What commands that read recordings say about those that gave nothing."""

from __future__ import annotations

from prbench.cli.builds import note_recordings
from prbench.sequences import Recording


def record(name: str, status: str, outcomes: dict[str, int], message: str = "", **more) -> Recording:
    return Recording(name, "somebody", "train", name, 60.0, outcomes, status, message, **more)


def test_recordings_that_gave_no_sequence_are_named_with_the_cause_and_not_with_every_remark(capsys):
    size = "size of the glasses unknown, DVT-L assumed: gaze origins may be off by 2.4 mm"
    lacks = ("no valid gaze, so no event can be primed",)
    note_recordings(
        [
            record("blind", "read", {"not_primed": 2, "too_short": 3}, size, lacks=lacks),
            record("idle", "read", {}, size, lacks=("no hand of the wearer took up or put down an object",)),
            record("quiet", "read", {"minimum_movement": 1}, size),
            record("fine", "read", {"sequence": 1, "not_primed": 4}, "gaze on half of the frames"),
            record("broken", "failed", {}, "no file"),
        ],
        reused=0,
    )
    assert capsys.readouterr().err.splitlines() == [
        "failed: broken: no file",
        "no sequence: blind: of 5 events 3 too_short, 2 not_primed; no valid gaze, so no event can be primed",
        "no sequence: idle: no candidate event; no hand of the wearer took up or put down an object",
        "no sequence: quiet: of 1 events 1 minimum_movement",
    ]


def test_recordings_that_are_cut_short_are_named_with_the_stream(capsys):
    found = {"sequence": 1}
    cut = record("cut", "read", found, shortfalls=("objects (o.csv) ends",))
    note_recordings([record("whole", "read", found), cut], reused=0)
    assert capsys.readouterr().err == "cut short: cut: objects (o.csv) ends\n"
