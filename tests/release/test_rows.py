"""Tables that curation built from synthetic recordings of each dataset go through the layout without change."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from prbench.geometry.skeleton import transform_points
from prbench.harness.synthetic_table import build_synthetic_table
from prbench.release.exporting import export_release
from prbench.release.importing import import_release
from prbench.release.layout import folder_of, load_known
from prbench.sequences import SequenceTable
from prbench.synthetic.people import PRESETS as ALL_PRESETS

PRESETS = sorted(set(ALL_PRESETS) & set(load_known().datasets))


@pytest.fixture(scope="module", params=PRESETS)
def table(request, tmp_path_factory) -> SequenceTable:
    folder = tmp_path_factory.mktemp("curated") / "table"
    build_synthetic_table(request.param, 1, 3, folder, n_events=6)
    return SequenceTable.open(folder)


def test_a_curated_table_comes_back_without_change(table, tmp_path) -> None:
    export_release([table.folder], tmp_path / "release")
    import_release(tmp_path / "release", tmp_path / "back")
    back = SequenceTable.open(tmp_path / "back" / table.info.dataset)
    assert back.identity == table.identity
    assert back.content == table.content


def as_the_authors_would(release: Path, *, in_world: bool) -> None:
    """Leave nothing but what the authors' page promises, in the canonical frames or in the recordings' worlds."""
    shutil.rmtree(release / "further")
    (release / "prbench_export.json").unlink()
    path = release / "target_information.json"
    promised = ("goal_location", "text_prompt", "subset", "primed_frame")
    entries = json.loads(path.read_text("utf-8"))
    for key, entry in entries.items() if in_world else ():
        world_from_canonical = np.array(entry["prbench"]["world_from_canonical"]).reshape(4, 4)
        turn = world_from_canonical.copy()
        turn[:3, 3] = 0
        for kind, matrix in (("motions", world_from_canonical), ("gazes", turn)):
            file = release / kind / f"{key}.npy"
            np.save(file, transform_points(matrix, np.load(file).astype(np.float64)).astype(np.float32))
        entry["goal_location"] = transform_points(world_from_canonical, np.array(entry["goal_location"])).tolist()
    bare = {key: {name: entry[name] for name in promised} for key, entry in entries.items()}
    path.write_text(json.dumps(bare), encoding="utf-8")


@pytest.mark.parametrize("frame", ["canonical", "world"])
def test_with_nothing_but_what_the_page_promises_everything_is_inferred_right(table, frame, tmp_path) -> None:
    export_release([table.folder], tmp_path / "release")
    as_the_authors_would(tmp_path / "release" / folder_of(table.info.dataset), in_world=frame == "world")
    report = import_release(tmp_path / "release", tmp_path / "back").tables[0]
    assert report.left_out == 0
    found = {each.name: each.value for each in report.inferred}
    assert found["fps"] == "20"
    assert found["units"] == "metres"
    assert found["motion_frame"].startswith(frame)
    assert found["goal_frame"] == "as the motions"
    back = SequenceTable.open(tmp_path / "back" / table.info.dataset)
    columns = ["joints", "goal_location", "gaze_valid", "action", "split", "prime_frame"]
    before, after = (list(each.chunks(columns=columns, rows=10_000)) for each in (table, back))
    np.testing.assert_allclose(after[0].joints, before[0].joints, atol=1e-5)
    np.testing.assert_allclose(after[0].vectors("goal_location"), before[0].vectors("goal_location"), atol=1e-5)
    np.testing.assert_array_equal(after[0].frames("gaze_valid"), before[0].frames("gaze_valid"))
    for name in ("action", "split"):
        assert after[0].strings(name) == before[0].strings(name), name
