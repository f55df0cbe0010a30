"""Files that are no files, nest without end or declare what they do not hold: each is refused, the others are read."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from prbench.curation import BuildOptions, CurationOptions, build_dataset
from prbench.errors import InputFileError, PrbenchError, UnforeseenInput
from prbench.readers import reader_for
from prbench.readers.discover import discover
from prbench.readers.extents import damage
from prbench.readers.gimo.table import read_segments
from prbench.readers.mogaze.files import dataset, numbers, opened
from prbench.sequences import SequenceTable
from prbench_adapters.corpora.humanml3d.files import read_joints
from tests.bombs import empty_rows
from tests.recording.mogaze_scene import write_scene

DEEP = b'{"unknown":' + b"[" * 100_000 + b"]" * 100_000 + b"}"


def _folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _looping_link(path: Path) -> None:
    path.unlink()
    path.symlink_to(path)


def _deep(path: Path) -> None:
    path.write_bytes(DEEP)


def _text(path: Path) -> None:
    path.write_text("hello, world\n")


def _nothing(path: Path) -> None:
    path.write_bytes(b"")


DAMAGES = (_folder, _looping_link, _deep, _text, _nothing)


def _refusals(dataset_name: str, root: Path) -> list[PrbenchError]:
    """What finding and reading every recording below a root was refused with."""
    reader, refusals = reader_for(dataset_name), []
    try:
        found = reader.find(root)
    except PrbenchError as error:
        return [error]
    for recording in found:
        try:
            reader.read(recording)
        except PrbenchError as error:
            refusals.append(error)
    return refusals


@pytest.mark.parametrize("damaged", DAMAGES, ids=lambda damaged: damaged.__name__[1:])
def test_no_file_of_a_recording_can_be_replaced_by_something_that_nobody_foresaw(folder, tmp_path, damaged):
    """ADT for CSV and JSON, MoGaze for HDF5; the marker ``fuzz`` stands for the other layouts."""
    write_scene(tmp_path)
    for name, root in (("adt", folder), ("mogaze", tmp_path / "mogaze")):
        for path in sorted(path for path in root.rglob("*") if path.is_file()):
            kept = path.read_bytes()
            damaged(path)
            unforeseen = [error for error in _refusals(name, root) if isinstance(error, UnforeseenInput)]
            assert not unforeseen, f"{path.name}: {unforeseen[0]}"
            path.rmdir() if path.is_dir() and not path.is_symlink() else path.unlink()
            path.write_bytes(kept)
        assert _refusals(name, root) == []


def test_metadata_nested_without_end_costs_one_recording_and_not_the_build(folder, tmp_path):
    other = Path(shutil.copytree(folder, folder.parent / "other"))
    (other / "metadata.json").write_bytes(DEEP)
    trusted = BuildOptions(curation=CurationOptions(shift=(("head", 0.0),)))  # the head of these files lies upside down
    report = build_dataset("adt", folder.parent, tmp_path / "out" / "table", options=trusted)
    assert [(record.recording_id, record.status) for record in report.records] == [
        ("other", "failed"),
        ("still_life", "read"),
    ]
    assert "other/metadata.json: expected values nested at most" in report.records[0].message
    assert report.info.counts.recordings_failed == 1


def test_a_mark_nested_without_end_is_one_message(folder):
    (folder / "synthetic.json").write_bytes(DEEP)
    with pytest.raises(InputFileError, match=r"synthetic\.json: expected values nested"):
        reader_for("adt").find(folder)
    (broken,) = discover(folder).broken
    assert "synthetic.json: expected values nested" in broken.message


def test_a_link_that_leads_nowhere_costs_one_recording(folder):
    other = Path(shutil.copytree(folder, folder.parent / "other"))
    _looping_link(next(other.glob("Skeleton_*.json")))
    found = reader_for("adt").find(folder.parent)
    assert [recording.recording_id for recording in found] == ["other", "still_life"]
    with pytest.raises(InputFileError, match=r"Skeleton_.*\.json: expected a file that can be read"):
        reader_for("adt").read(found[0])
    reader_for("adt").read(found[1])


def test_a_root_that_is_a_looping_link_is_one_message(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name in ("adt", "gimo", "hd-epic", "hot3d", "mogaze"):
        with pytest.raises(InputFileError, match="loop") as caught:
            reader_for(name).find(tmp_path / "loop")
        assert not isinstance(caught.value, UnforeseenInput)


@pytest.mark.parametrize("hint", ["nan", "inf", "1e300"])
def test_a_hint_of_gimo_that_is_no_frame_is_no_hint(tmp_path, hint):
    path = tmp_path / "dataset.csv"
    path.write_text(
        "sequence_path,start_frame,end_frame,scene,transformation,training,action,\n"
        f"S,10,50,room,t.json,1,walk,{hint}\n"
    )
    assert read_segments(path)[0][0].segment.hint is None


def test_rows_of_mogaze_that_are_declared_and_not_stored_are_refused(tmp_path):
    (human,) = write_scene(tmp_path).glob("*_human_data.hdf5")
    with h5py.File(human, "r") as file:
        (name,) = (key for key in file if isinstance(file[key], h5py.Dataset))
        columns = file[name].shape[1]
    for rows in (150_000, 40_000_000, 2**38):
        empty_rows(human, name, rows, columns)
        (refusal,) = _refusals("mogaze", human.parent)
        assert f"expected at most 67,108,864 bytes of values, for 0 that are stored, found shape ({rows}" in str(
            refusal
        )


def _external_link(file: h5py.File, other: Path) -> None:
    file["data"] = h5py.ExternalLink(str(other), "data")


def _soft_link(file: h5py.File, _: Path) -> None:
    file["data"] = h5py.SoftLink("/elsewhere")


def _external_storage(file: h5py.File, other: Path) -> None:
    file.create_dataset("data", shape=(4, 8), dtype="f8", external=[(str(other), 0, h5py.h5f.UNLIMITED)])


def _virtual(file: h5py.File, other: Path) -> None:
    layout = h5py.VirtualLayout(shape=(4, 8), dtype="f8")
    layout[:] = h5py.VirtualSource(str(other), "data", shape=(4, 8))
    file.create_virtual_dataset("data", layout)


@pytest.mark.parametrize("elsewhere", [_external_link, _soft_link, _external_storage, _virtual])
def test_values_in_other_files_are_never_followed(tmp_path, elsewhere: Callable[[h5py.File, Path], None]):
    with h5py.File(tmp_path / "other.hdf5", "w") as file:
        file["data"] = np.zeros((4, 8))
    path = tmp_path / "a.hdf5"
    with h5py.File(path, "w") as file:
        elsewhere(file, tmp_path / "other.hdf5")
    with (
        opened(path) as file,
        pytest.raises(InputFileError, match=r"a\.hdf5, .*in this file, found (a link|values in)"),
    ):
        numbers(path, dataset(path, file, "data"), columns=8)


def test_text_where_an_array_is_expected_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.full((3, 22, 3), "text"))
    with pytest.raises(InputFileError, match=r"a\.npy: expected numbers of the shape") as caught:
        read_joints(tmp_path / "a.npy")
    assert not isinstance(caught.value, UnforeseenInput)


def test_inspection_tells_what_is_no_file_and_goes_on(folder):
    recording, *_ = reader_for("adt").find(folder)
    file = next(file for file in recording.files if file.path.suffix == ".csv")
    _folder(file.path)
    assert damage(file) == "cannot be read (a folder)"


def test_a_folder_in_place_of_a_tables_description_is_one_message(folder, tmp_path):
    table = build_dataset("adt", folder, tmp_path / "table").folder
    _folder(table / "dataset.json")
    with pytest.raises(InputFileError, match=r"dataset\.json: expected a file, found a folder"):
        SequenceTable.open(table)
