"""URLs are told from paths, and those with secrets are refused without repeating them."""

from __future__ import annotations

from pathlib import Path

import pytest

from prbench.errors import UsageError
from prbench.object_stores.store import StoreUrl, is_url


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
