"""URLs are told from paths, secrets in them are not repeated, and manifests are read with suspicion."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from prbench.errors import InputFileError, UsageError
from prbench.object_stores.store import (
    FINISHED,
    FolderManifest,
    StoredFile,
    StoreUrl,
    decode_manifest,
    describe,
    is_url,
    stays_inside,
)


@pytest.mark.parametrize(
    "text", ["s3://bucket/a", "gs://b", "hf://datasets/a/b", "abfs://c@account.net/x", "memory://x"]
)
def test_urls_are_recognised(text):
    assert is_url(text)
    assert str(StoreUrl.parse(f"{text}/")) == text


@pytest.mark.parametrize("text", ["tables/adt", "/data/s3:/x", "C:\\data", "adt", "", None, Path("a/b")])
def test_paths_are_none(text):
    assert not is_url(text)


def test_a_url_that_became_a_path_is_refused():
    with pytest.raises(UsageError, match="give a URL as text"):
        is_url(Path("s3://bucket/table"))


@pytest.mark.parametrize(
    "text",
    [
        "s3://key:hunter2@bucket/table",
        "https://hunter2@host/table",
        "https://host/table?X-Amz-Signature=hunter2",
        "s3://bucket/table#hunter2",
        "abfs://container:hunter2@account/x",
    ],
)
def test_what_might_be_secret_is_refused_and_not_repeated(text):
    with pytest.raises(UsageError) as refused:
        StoreUrl.parse(text)
    assert "hunter2" not in str(refused.value)
    assert "credentials" in str(refused.value)


@pytest.mark.parametrize("text", ["s3://", "s3:///", "s3://bucket/../other", "simplecache::s3://bucket/x"])
def test_what_names_no_folder_is_refused(text):
    with pytest.raises(UsageError):
        StoreUrl.parse(text)


def test_the_local_copy_bears_the_last_part_of_the_path_where_a_folder_can():
    assert StoreUrl.parse("s3://bucket/tables/adt").name == "adt"
    assert StoreUrl.parse("s3://bucket/tables/.hidden").name == "copy"
    assert StoreUrl("s3://bucket/a").cache != StoreUrl("s3://bucket/b").cache


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
