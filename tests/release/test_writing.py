"""An imported or exported dataset names the terms of everybody who has a say in it."""

from __future__ import annotations

import json

import msgspec
import pytest

from prbench.cli import main
from prbench.errors import RedistributionError
from prbench.protocol.manifests import load_manifest
from prbench.release.exporting import export_release
from prbench.release.importing import import_release, terms_of
from prbench.release.layout import dataset_of, folder_of, load_known
from prbench.sequences import DatasetInfo
from prbench.sequences.dataset_info import NOTICE_FILE, may_pass_on
from tests.release.releases import rows, write_release
from tests.release.tables import looking_table


@pytest.mark.parametrize("dataset", ["adt", "gimo", "mogaze", "hot3d", "hd-epic"])
def test_a_released_dataset_names_the_study_and_the_source(dataset, tmp_path, capsys) -> None:
    manifest = load_manifest(dataset)
    write_release(tmp_path / "root" / folder_of(dataset), rows(6, dataset))
    report = import_release(tmp_path / "root", tmp_path / "out").tables[0]
    info = DatasetInfo.read(tmp_path / "out" / dataset)
    assert manifest.licence in info.licence
    assert "Prime and Reach release" in info.licence
    assert "hatano_prime_and_reach" in info.citation
    assert manifest.citation.strip() in info.citation
    assert info.redistribution == ("none" if manifest.redistribution == "none" else "non-commercial")
    assert not info.synthetic
    assert main(["datasets", "--cite", str(tmp_path / "out" / dataset)]) == 0
    assert capsys.readouterr().out.count("hatano_prime_and_reach") == 1
    assert any(f"the study has {load_known().datasets[dataset].train}" in warning for warning in report.warnings)


def test_terms_of_an_export_can_be_stricter_than_the_manifests_but_never_looser() -> None:
    gimo, adt = load_manifest("gimo"), load_manifest("adt")
    assert terms_of("gimo", gimo, {"redistribution": "yes"})["redistribution"] == "none"
    assert terms_of("adt", adt, {"redistribution": "none"})["redistribution"] == "none"
    assert terms_of("adt", adt, {"redistribution": "as you like"})["redistribution"] == "none"
    assert "Prime and Reach" not in terms_of("adt", adt, {"redistribution": "yes"})["licence"]


@pytest.mark.parametrize("kind", ["none", "non-commercial", "yes"])
def test_export_obeys_the_terms(kind, tmp_path, capsys) -> None:
    free = looking_table(tmp_path / "free", 4, dataset="synthetic-mogaze")
    table = looking_table(tmp_path / "table", 4)
    msgspec.structs.replace(DatasetInfo.read(table.folder), redistribution=kind).write(table.folder)
    arguments = ["export-release", str(free.folder), str(table.folder), "--out", str(tmp_path / "release")]
    if kind == "none":
        with pytest.raises(RedistributionError, match="--permission synthetic-adt"):
            export_release([free.folder, table.folder], tmp_path / "release")
        assert not (tmp_path / "release").exists(), "nothing is written, not even what would be allowed"
        assert main([*arguments, "--permission", "synthetic-mogaze"]) == 10
        arguments += ["--permission", "synthetic-adt"]
    assert main(arguments) == 0
    file = tmp_path / "release" / "synthetic-adt" / NOTICE_FILE
    assert file.is_file() == (kind != "yes")
    record = json.loads((tmp_path / "release" / "synthetic-adt" / "prbench_export.json").read_text("utf-8"))
    assert record["permission_stated"] == (kind == "none")
    assert record["redistribution"] == kind
    assert ("notice: " in capsys.readouterr().out) == (kind != "yes")


def test_a_table_that_may_not_be_passed_on_stays_so_after_a_round_trip(tmp_path) -> None:
    table = looking_table(tmp_path / "table", 6, dataset="gimo")
    info = DatasetInfo.read(table.folder)
    msgspec.structs.replace(info, redistribution="none", synthetic=False).write(table.folder)
    export_release([table.folder], tmp_path / "release", permitted=["gimo"])
    assert (tmp_path / "release" / "GIMO" / "motions").is_dir()
    import_release(tmp_path / "release", tmp_path / "back")
    assert not may_pass_on(DatasetInfo.read(tmp_path / "back" / "gimo"))


@pytest.mark.parametrize(
    ("folder", "dataset"),
    [
        ("HD-EPIC", "hd-epic"), ("hd_epic", "hd-epic"), ("HDEPIC", "hd-epic"), ("MoGaze", "mogaze"),
        ("synthetic-ADT", "synthetic-adt"), ("motions", None), ("ADT2", None),
    ],
)  # fmt: skip
def test_folders_are_recognised_by_their_letters(folder, dataset) -> None:
    assert dataset_of(folder) == dataset


def test_folders_are_written_as_the_authors_do() -> None:
    assert [folder_of(name) for name in ("hd-epic", "mogaze", "hot3d", "adt", "gimo", "synthetic-adt")] == [
        "HD-EPIC", "MoGaze", "HOT3D", "ADT", "GIMO", "synthetic-adt",
    ]  # fmt: skip
