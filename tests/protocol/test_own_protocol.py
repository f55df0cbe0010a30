"""A user's own protocol is read whole, stamped where it is used, and mixed with no other."""

from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from prbench.board import collect_runs, compare_runs, export, make_leaderboard
from prbench.curation import BuildOptions, build_from_sources
from prbench.engine import InProcess, ProcessPool
from prbench.errors import InputFileError, RunError, TableError, UsageError
from prbench.harness.request import RunRequest
from prbench.harness.results import RunChecker
from prbench.harness.run import run_method
from prbench.harness.run_folder import RunFolder, read_scores
from prbench.harness.run_folder.summary import DatasetAgreement
from prbench.harness.score_predictions import ScoreRequest, score_predictions
from prbench.protocol.manifests import BenchmarkProtocol, digest_of, load_protocol
from prbench.protocol.own_protocol import FILE_NAME, read_protocol, write_protocol
from prbench.sequences import SequenceTable
from tests.curation.sources import folder_bytes, some_sources
from tests.fakes import fake_dataset

DEFAULT = (resources.files("prbench_benchmarks.prime_and_reach") / "protocol.toml").read_text(encoding="utf-8")


def own(folder: Path, *changes: tuple[str, str], name: str = "mine") -> Path:
    """Write prbench's protocol under another name, with some lines changed."""
    text = DEFAULT.replace("version = 4", f'name = "{name}"\nversion = 4')
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    folder.mkdir(exist_ok=True)
    (folder / "own.toml").write_text(text, encoding="utf-8")
    return folder / "own.toml"


def test_every_value_but_the_name_of_prbenchs_own_protocol_stands_in_its_digest() -> None:
    protocol = load_protocol()
    values = msgspec.to_builtins(protocol)
    del values["name"]
    assert protocol.digest == hashlib.sha256(msgspec.json.encode(values, order="sorted")).hexdigest()
    lasting = msgspec.structs.replace(protocol.curation, minimum_prime=0.1)
    assert digest_of(msgspec.structs.replace(protocol, curation=lasting)) != protocol.digest
    assert digest_of(msgspec.structs.replace(protocol, name="mine")) != protocol.digest


def test_a_file_with_every_key_is_read_and_written_back(tmp_path: Path) -> None:
    protocol = read_protocol(own(tmp_path, ("prime_distance = 0.25", "prime_distance = 0.3")))
    assert (protocol.name, protocol.metrics.prime_distance, protocol.is_own) == ("mine", 0.3, True)
    write_protocol(tmp_path, protocol)
    assert read_protocol(tmp_path / FILE_NAME) == protocol
    write_protocol(tmp_path / "none", load_protocol())
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("lead = 2.0 ", "# ", r"curation: .*found Object missing required field `lead`"),
        ("lead = 2.0 ", "lead = 2.0\nleed = 2.0 ", r"curation: .*unknown field `leed`\. Did you mean 'lead'"),
        ("lead = 2.0 ", 'lead = "2" ', r"curation\.lead: expected a value of the key's type"),
        ("lead = 2.0 ", "lead = -2.0 ", r"curation\.lead: expected a finite number 0 or more, found -2"),
        ("lead = 2.0 ", "lead = nan ", r"curation\.lead: expected a finite number"),
        ("fps = 20.0 ", "fps = 0.0 ", r"fps: expected a finite number above 0"),
        ("test = 0.30 ", "test = 1.7 ", r"splits\.test: expected a share from 0 to 1"),
        ("test = 0.30 ", "test = 0.95 ", r"splits\.validation: expected at most what splits\.test leaves \(0\.05\)"),
        ('"none", "text"', '"text", "none"', "conditions: expected the four conditions"),
        ('name = "mine"', 'name = "prime-and-reach"', "name: expected small letters"),
        ('name = "mine"', 'name = "../x"', "name: expected small letters"),
        ('name = "mine"', "", "name: expected small letters"),
        ("version = 4", "version = 0", "version: expected 1 or more"),
        ("[metrics]", "[metrics", "expected a TOML file"),
        (
            "bearing = [30.0, 90.0]",
            "bearing = [90.0, 30.0]",
            r"breakdown\.bearing: expected finite numbers .*ascending",
        ),
        ("height = [0.7, 1.4]", "height = [0.7, nan]", r"breakdown\.height: expected finite numbers"),
        ("fewest_recordings = 6", "fewest_recordings = 1", r"breakdown\.fewest_recordings: expected 2 or more"),
    ],
)
def test_a_file_that_is_no_protocol_is_refused_by_key(tmp_path: Path, before: str, after: str, message: str) -> None:
    path = own(tmp_path)
    text = path.read_text(encoding="utf-8")
    assert before in text
    path.write_text(text.replace(before, after, 1), encoding="utf-8")
    with pytest.raises(InputFileError, match=message):
        read_protocol(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match=r"none\.toml: expected a protocol's TOML file"):
        read_protocol(tmp_path / "none.toml")


def built(folder: Path, protocol: BenchmarkProtocol | None, *, workers: int = 1) -> SequenceTable:
    engine = ProcessPool(workers) if workers > 1 else InProcess()
    build_from_sources(some_sources(), folder, options=BuildOptions(protocol=protocol), engine=engine)
    return SequenceTable.open(folder)


def test_a_build_follows_it_in_every_worker_and_bears_its_stamp(tmp_path: Path) -> None:
    protocol = read_protocol(own(tmp_path, ("fps = 20.0", "fps = 25.0")))
    table = built(tmp_path / "one", protocol)
    built(tmp_path / "two", protocol, workers=2)
    assert folder_bytes(tmp_path / "one") == folder_bytes(tmp_path / "two")
    assert set(table.scalars()["fps"].to_pylist()) == {25.0}
    assert table.info.options["protocol"] == "mine 4"
    assert table.info.protocol_digest == protocol.digest
    assert table.described_protocol.protocol() == protocol
    plain = built(tmp_path / "plain", None)
    assert "protocol" not in plain.info.options
    assert not (tmp_path / "plain" / FILE_NAME).exists()


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> SequenceTable:
    """A table of prbench's own protocol."""
    made = fake_dataset(tmp_path_factory.mktemp("own") / "table", 24, recordings=12)
    msgspec.structs.replace(made.info, protocol_digest=load_protocol().digest).write(made.folder)
    return SequenceTable.open(made.folder)


def run(table: SequenceTable, out: Path, protocol: Path | None = None, *, workers: int = 1) -> RunFolder:
    engine = ProcessPool(workers) if workers > 1 else InProcess()
    request = RunRequest(method="scripted", data=(table.folder,), out=out, protocol=protocol, batch_size=2)
    return run_method(request, engine=engine).folder


def test_a_run_is_scored_by_it_in_every_worker_stamped_and_verified(table: SequenceTable, tmp_path: Path) -> None:
    strict = own(tmp_path, ("location_error_distance = 0.50", "location_error_distance = 0.0"))
    plain = run(table, tmp_path / "plain")
    mine = run(table, tmp_path / "mine", strict)
    many = run(table, tmp_path / "many", strict, workers=2)
    name = table.info.dataset
    assert read_scores(mine.dataset(name).scores).equals(read_scores(many.dataset(name).scores))
    rates = {}
    for made in (plain, mine):
        rows = read_scores(made.dataset(name).scores).to_pylist()
        rates[made.path.name] = {row["value"] for row in rows if row["metric"] == "location_error"}
    assert rates["mine"] == {1.0}
    assert rates["plain"] != {1.0}
    assert mine.protocol == read_protocol(strict)
    assert mine.record.protocol_digest == read_protocol(strict).digest
    assert not (plain.path / FILE_NAME).exists()
    assert RunChecker(lambda _: table).check(mine, mine.record.tables[0]).unverified == ""
    again = score_predictions(ScoreRequest(predictions=mine.path, data=(table.folder,)))[0]
    assert again.scores.equals(read_scores(mine.dataset(name).scores))
    other = score_predictions(ScoreRequest(predictions=plain.path, data=(table.folder,), protocol=strict))[0]
    assert other.scores.equals(again.scores)


def test_the_agreement_with_people_follows_it_and_is_verified(table: SequenceTable, tmp_path: Path) -> None:
    changes = (("distance = [0.8, 2.0] ", "distance = [0.5] "), ("reach_distance = 0.10", "reach_distance = 9.0"))
    mine = run(table, tmp_path / "mine", own(tmp_path, *changes))
    agreement = DatasetAgreement.read(mine.dataset(table.info.dataset).path)
    assert {one.end for one in agreement.breakdown if one.by == "distance"} == {0.5, None}
    # Recorded people reach within nine metres always, within ten centimetres seldom.
    assert {one.people for one in agreement.rates if one.metric == "reach_success"} == {1.0}
    checker = RunChecker(lambda _: table)
    assert checker.check(mine, mine.record.tables[0]).unverified == ""
    run(table, tmp_path / "mine", own(tmp_path, *changes))
    path = mine.dataset(table.info.dataset).agreement
    path.write_text(path.read_text().replace('"end": 0.5', '"end": 0.6'))
    with pytest.raises(RunError, match=r"agreement\.json, breakdown"):
        checker.check(mine, mine.record.tables[0])


def test_runs_of_two_protocols_stand_in_two_tables_and_are_not_compared(table: SequenceTable, tmp_path: Path) -> None:
    run(table, tmp_path / "runs" / "plain")
    run(table, tmp_path / "runs" / "mine", own(tmp_path, ("reach_distance = 0.10", "reach_distance = 0.2")))
    board = make_leaderboard(collect_runs([tmp_path / "runs"]))
    assert [part.protocol for part in board.tables if part.protocol] == ["mine 4"]
    assert len(board.tables) == 2
    text = export(board, "md")
    assert "own protocol mine 4" in text
    assert "differ in protocol" in text
    assert "own protocol mine 4" in export(board, "csv")
    with pytest.raises(RunError, match="different protocols"):
        compare_runs(tmp_path / "runs" / "plain", tmp_path / "runs" / "mine")
    with pytest.raises(RunError, match="protocol_digest"):
        run(table, tmp_path / "runs" / "plain", own(tmp_path))


def test_a_run_with_a_changed_copy_is_refused(table: SequenceTable, tmp_path: Path) -> None:
    made = run(table, tmp_path / "mine", own(tmp_path))
    copy = made.path / FILE_NAME
    copy.write_text(copy.read_text(encoding="utf-8").replace("prime_distance = 0.25", "prime_distance = 9.0"))
    with pytest.raises(RunError, match=r"protocol\.toml: expected the protocol that was followed here"):
        collect_runs([made.path])


def test_a_table_of_other_rules_is_refused_by_key(table: SequenceTable, tmp_path: Path) -> None:
    slow = own(tmp_path / "slow", ("lead = 2.0", "lead = 1.0"))
    with pytest.raises(UsageError, match=r"curation\.lead: 1\.0, but the table .* was built with 2\.0"):
        run(table, tmp_path / "out", slow)
    mine = built(tmp_path / "table", read_protocol(slow))
    with pytest.raises(UsageError, match=r"follows a protocol of its own, mine 4\. Name it: --protocol"):
        run(mine, tmp_path / "out")
    (mine.folder / FILE_NAME).unlink()
    with pytest.raises(TableError, match=r"follows the protocol mine 4, and its protocol\.toml is missing"):
        run(mine, tmp_path / "out", slow)
    assert not (tmp_path / "out").exists()


def test_motions_of_a_file_are_scored_by_it_and_stamped(table: SequenceTable, tmp_path: Path) -> None:
    motions = run(table, tmp_path / "run").dataset(table.info.dataset).predictions / "part-00000.parquet"
    strict = own(tmp_path, ("location_error_distance = 0.50", "location_error_distance = 0.0"))
    whole = tmp_path / "motions.parquet"
    parts = sorted(motions.parent.glob("part-*.parquet"))
    pq.write_table(pa.concat_tables(pq.read_table(part) for part in parts), whole)
    request = ScoreRequest(predictions=whole, data=(table.folder,), protocol=strict, out=tmp_path / "scored")
    score_predictions(request)
    scored = RunFolder.open(tmp_path / "scored")
    assert scored.protocol == read_protocol(strict)
