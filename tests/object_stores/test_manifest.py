"""Manifests are read with suspicion, and equal folders have equal ones."""

from __future__ import annotations

import msgspec
import pytest

from prbench.errors import InputFileError
from prbench.object_stores.store import FINISHED, FolderManifest, StoredFile, decode_manifest, describe, stays_inside

ENTRY = StoredFile(size=3, sha256="0" * 64)


def test_the_order_of_files_does_not_matter():
    assert FolderManifest.of({"a": ENTRY, "b": ENTRY}).digest == FolderManifest.of({"b": ENTRY, "a": ENTRY}).digest


def test_a_manifest_survives_the_way_through_bytes():
    manifest = FolderManifest.of({"a/b.parquet": ENTRY})
    assert decode_manifest(manifest.encoded(), "here") == manifest


@pytest.mark.parametrize("name", ["../x", "a/../../x", "/etc/passwd", "a//b", "./a", "", "C:/x", "a\\b", "a\nb", "a/"])
def test_names_that_lead_out_of_the_folder_are_refused(name):
    assert not stays_inside(name)
    for files in ({name: ENTRY}, {"a": msgspec.structs.replace(ENTRY, object=name)} if name else {name: ENTRY}):
        with pytest.raises(InputFileError, match="may lead out of it"):
            decode_manifest(FolderManifest.of(files).encoded(), "here")


@pytest.mark.parametrize(
    ("content", "found"),
    [
        (b"{", "truncated"),
        (b"[]", "Expected `object`"),
        (b'{"schema_version": 2, "files": {}}', "version 2"),
        (b'{"schema_version": 1, "files": {"a": {"size": -1, "sha256": "x"}}}', "-1"),
    ],
)
def test_what_is_no_manifest_is_refused(content, found):
    with pytest.raises(InputFileError, match=found):
        decode_manifest(content, "here")


def test_a_local_folder_is_described_for_other_programs_that_copy_it(tmp_path):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "a").write_bytes(b"abc")
    (tmp_path / ".hidden").write_bytes(b"x")
    described = describe(tmp_path)
    assert list(described.files) == ["part/a"]
    assert decode_manifest((tmp_path / FINISHED).read_bytes(), "here") == described
    assert describe(tmp_path) == described  # the manifest itself is none of the files
