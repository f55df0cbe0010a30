"""docs/own-recordings.md: its code brings a tracker's foreign format in, and its commands find when people looked."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from prbench.cli import main
from prbench.protocol.manifests import load_manifest
from prbench.readers.own import format as own
from prbench.sequences import SequenceTable
from tests.readers.own.plain import recording_of, tree

PAGE = (Path(__file__).parents[2] / "docs" / "own-recordings.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^```(\w+)\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE))


def write_foreign(path: Path) -> None:
    """Write a recording as the page's tracker does: JSON lines, cm, ms, Z up, x y z w, yaw and pitch in degrees."""
    recording = recording_of("hd-epic")
    axes = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])  # z up from y up
    head = recording.head
    turned = Rotation.from_matrix(axes @ Rotation.from_quat(head.rotation, scalar_first=True).as_matrix()).as_quat()
    rows: list[dict] = [
        {"kind": "pose", "ms": time * 1e3, "pos": (100 * axes @ place).tolist(), "rot": turn.tolist()}
        for time, place, turn in zip(head.times, head.position, turned)
    ]
    gaze = recording.gaze
    facing = Rotation.from_quat(head.pose_at(gaze.times)[1], scalar_first=True)
    for time, (x, y, z), valid in zip(gaze.times, facing.inv().apply(gaze.direction), gaze.valid):
        angles = (np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(y))) if valid else (None, None)
        rows.append({"kind": "gaze", "ms": time * 1e3, "yaw": angles[0], "pitch": angles[1]})
    for event in recording.annotated_events:
        if event.location is not None:
            told = {"what": event.action, "thing": event.object_name, "at": (100 * axes @ event.location).tolist()}
            rows.append({"kind": "event", "ms": event.event_time * 1e3, **told})
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")


def primes(folder: Path) -> list[tuple]:
    events = SequenceTable.open(folder).events()
    rows = zip(events["event_time"].to_pylist(), events["prime_time"].to_pylist(), events["location"].to_pylist())
    return sorted((time, prime or 0.0) for time, prime, place in rows if place is not None)


def test_the_page_brings_a_foreign_format_in_and_finds_the_same_primes(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    write_foreign(tmp_path / "walk.jsonl")
    exec(compile(BLOCKS["python"], "own-recordings.md", "exec"), {})
    (tmp_path / "kitchen.toml").write_text(BLOCKS["toml"], encoding="utf-8")
    printed = ""
    for line in BLOCKS["bash"].splitlines():
        assert main(shlex.split(line)[1:]) == 0, line
        printed += capsys.readouterr().out
    assert "walk  complete" in re.sub(" +", "  ", printed)
    assert "6 events have prime times in events.parquet; sequences need bodies" in printed
    assert "first look at 38764.926 s" in printed
    assert main(["build-dataset", "hd-epic", "--root", str(tree("hd-epic")), "--out", "original"]) == 0
    np.testing.assert_allclose(primes(tmp_path / "tables/kitchen"), primes(tmp_path / "original"), rtol=0, atol=1e-4)
    info = SequenceTable.open(tmp_path / "tables/kitchen").info
    assert (info.dataset, info.title, info.licence, info.redistribution) == (
        "own-kitchen", "Our kitchen", "CC BY 4.0", "yes",
    )  # fmt: skip


def test_the_page_names_every_table_column_and_key() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| (.*) \|$", PAGE.partition("What a missing")[0], re.MULTILINE))
    for table, groups in own.TABLES.items():
        for column in {name for group in groups for name in group} - set(own.BOX):
            assert column in rows[table], (table, column)
    keys = {"participant", *(f"{part}.{key}" for part, form in (("units", own.Units), ("axes", own.Axes),
            ("head", own.HeadAxes), ("gaze", own.GazeFrame), ("video", own.Video), ("body", own.Body))
            for key in form.__struct_fields__)}  # fmt: skip
    assert all(f"`{key}`" in PAGE for key in keys)
    assert load_manifest("own").redistribution == "none"
