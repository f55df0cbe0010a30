"""run.json, summary.json: written, read back, compared, refused when damaged."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from prbench.errors import RunError
from prbench.harness.run_folder.folder import DatasetFolder, RunFolder
from prbench.harness.run_folder.record import BatchPlanRecord, MethodRecord, RunRecord, TableRecord
from prbench.harness.run_folder.summary import DatasetSummary, MetricSummary

DIGEST = "0123456789abcdef" * 4

PLAN = BatchPlanRecord(batch_size=4, batches=2, digest=DIGEST)
TABLE = TableRecord(
    dataset="synthetic-adt", title="ADT", synthetic=True, redistribution="yes", identity_digest=DIGEST,
    content_digest=DIGEST, sequences=8, unsupported=0, selection_digest=DIGEST, batch_plan=PLAN,
)  # fmt: skip
METHOD = MethodRecord(
    name="static", kind="built-in", package="prbench", version="1", weights=None, weights_digest=None,
    options={"pose-only": "true"}, max_frames=None, native_fps=None, motionless=True,
)  # fmt: skip
RECORD = RunRecord(
    schema_version=1, prbench_version="1", protocol_version=4, protocol_digest=DIGEST, method=METHOD, condition="none",
    control=None, split="test", limit=None, seed=0, samples=1, device="cpu", threads=1, packages={"numpy": "2.0"},
    tables=(TABLE, msgspec.structs.replace(TABLE, dataset="synthetic-gimo")),
)  # fmt: skip
METRIC = MetricSummary(
    metric="mpjpe", title="MPJPE", unit="m", mean=0.1, low=None, high=None, level=0.95, interval="none", sequences=8,
    recordings=2, marks=("few_recordings",), flags={},
)  # fmt: skip
SUMMARY = DatasetSummary(
    dataset="synthetic-adt", title="ADT (synthetic)", synthetic=True, redistribution="yes", method="static",
    condition="none", control=None, split="test", sequences=8, unsupported=0, recordings=2, samples=1,
    length_mismatches=0, metrics=(METRIC,),
)  # fmt: skip


def test_records_come_back_as_they_were_written(tmp_path):
    RECORD.write(tmp_path)
    SUMMARY.write(tmp_path)
    assert RunRecord.read(tmp_path) == RECORD
    assert DatasetSummary.read(tmp_path) == SUMMARY


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (msgspec.structs.replace(RECORD, seed=3), "run.json, seed: expected 0 for this run, found 3"),
        (msgspec.structs.replace(RECORD, limit=3), "limit: expected nothing for this run, found 3"),
        (
            msgspec.structs.replace(RECORD, method=msgspec.structs.replace(METHOD, options={})),
            r"method.options.pose-only: expected true for this run, found nothing",
        ),
        (
            msgspec.structs.replace(RECORD, packages={"numpy": "2.1"}),
            "packages.numpy: expected 2.0 for this run, found 2.1",
        ),
        (
            msgspec.structs.replace(RECORD, tables=(RECORD.tables[0],)),
            "tables.synthetic-gimo.dataset: expected synthetic-gimo for this run, found nothing",
        ),
        (
            msgspec.structs.replace(
                RECORD, tables=(RECORD.tables[0], msgspec.structs.replace(RECORD.tables[1], content_digest="f" * 64))
            ),
            "tables.synthetic-gimo.content_digest: expected 0123456789ab… for this run, found ffffffffffff…",
        ),
    ],
)
def test_the_first_key_that_differs_is_named_with_both_values(tmp_path, other, message):
    other.write(tmp_path)
    with pytest.raises(RunError, match=message):
        RunFolder.prepare(tmp_path, RECORD)


@pytest.mark.parametrize("field", RunRecord.__struct_fields__)
def test_every_field_of_a_record_counts(tmp_path, field):
    other = msgspec.structs.replace(RECORD.method, name="changed") if field == "method" else "changed"
    with pytest.raises(RunError, match=field):
        RECORD.require_same(msgspec.structs.replace(RECORD, **{field: other}), tmp_path)


def test_a_folder_is_prepared_once_and_entered_again(tmp_path):
    folder = RunFolder.prepare(tmp_path / "run", RECORD)
    before = (tmp_path / "run/run.json").stat().st_mtime_ns
    assert RunFolder.prepare(tmp_path / "run", RECORD) == folder
    assert (tmp_path / "run/run.json").stat().st_mtime_ns == before


@pytest.mark.parametrize("text", ["", "[]", '{"seed": 1}'])
def test_damaged_files_are_refused(tmp_path, text):
    for name, read in (("run.json", RunRecord.read), ("summary.json", DatasetSummary.read)):
        (tmp_path / name).write_text(text)
        with pytest.raises(RunError, match=rf"not a valid {name}"):
            read(tmp_path)


def test_missing_files_and_newer_versions_are_refused(tmp_path):
    with pytest.raises(RunError, match=r"expected a run folder \(with run.json\)"):
        RunRecord.read(tmp_path)
    with pytest.raises(RunError, match=r"the run is not finished"):
        DatasetSummary.read(tmp_path)
    values = msgspec.to_builtins(SUMMARY) | {"schema_version": 7}
    (tmp_path / "summary.json").write_text(json.dumps(values))
    with pytest.raises(RunError, match=r"not a valid summary.json: Expected `int` <= 1 - at `\$.schema_version`"):
        DatasetSummary.read(tmp_path)


def test_every_dataset_lies_in_a_folder_of_its_own(tmp_path):
    assert RunFolder(tmp_path, RECORD).dataset("synthetic-gimo") == DatasetFolder(tmp_path / "synthetic-gimo")
    single = msgspec.structs.replace(RECORD, tables=(TABLE,))
    assert RunFolder(tmp_path, single).dataset("synthetic-adt") == DatasetFolder(tmp_path / "synthetic-adt")
    with pytest.raises(RunError, match=r"the run is of synthetic-adt, not of gimo"):
        RunFolder(tmp_path, single).dataset("gimo")


@pytest.mark.parametrize("file", ["predictions/part-00000.parquet", ".costs/batch-00000.json", "scores.parquet"])
def test_a_run_of_earlier_versions_has_the_files_of_its_only_dataset_beside_its_record(tmp_path, file):
    single = msgspec.structs.replace(RECORD, tables=(TABLE,))
    single.write(tmp_path)
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_bytes(b"x")
    assert RunFolder.open(tmp_path).dataset("synthetic-adt") == DatasetFolder(tmp_path)
    assert RunFolder.prepare(tmp_path, single).dataset("synthetic-adt") == DatasetFolder(tmp_path)


def test_the_folder_of_a_dataset_means_the_run_that_it_is_part_of(tmp_path, monkeypatch):
    RECORD.write(tmp_path)
    part = tmp_path / "synthetic-gimo"
    part.mkdir()
    assert RunFolder.open(part) == RunFolder.prepare(part, RECORD) == RunFolder(tmp_path, RECORD)
    monkeypatch.chdir(part)
    assert RunFolder.open(Path()).path.samefile(tmp_path)
    (tmp_path / "notes").mkdir()
    with pytest.raises(RunError, match=r"notes: expected a run folder"):
        RunFolder.open(tmp_path / "notes")


def test_a_run_without_a_single_batch_is_discarded_and_any_other_is_not(tmp_path):
    folder = RunFolder.prepare(tmp_path / "run", RECORD)
    folder.discard_if_empty()
    assert not (tmp_path / "run").exists()
    folder = RunFolder.prepare(tmp_path / "run", RECORD)
    part = folder.dataset("synthetic-adt").part(0)
    part.parent.mkdir(parents=True)
    part.write_bytes(b"x")
    folder.discard_if_empty()
    assert part.exists()
    assert (tmp_path / "run/run.json").exists()


def test_a_record_from_before_methods_could_be_isolated_is_read_and_belongs_to_the_same_run(tmp_path):
    RECORD.write(tmp_path)
    old = json.loads((tmp_path / "run.json").read_text())
    assert old["method"].pop("isolation") is None
    (tmp_path / "run.json").write_text(json.dumps(old))
    RECORD.require_same(RunRecord.read(tmp_path), tmp_path)
    apart = msgspec.structs.replace(RECORD, method=msgspec.structs.replace(METHOD, isolation="process"))
    with pytest.raises(RunError, match=r"method\.isolation: expected process for this run, found nothing"):
        apart.require_same(RunRecord.read(tmp_path), tmp_path)
