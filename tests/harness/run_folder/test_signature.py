"""A signed run is exactly what its signer saw: any edit, loss or addition, or another key, is told by name."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import minisign
import pytest

from prbench.cli import main
from prbench.cli.run import PASSWORD_VARIABLE
from prbench.harness.methods.isolation import available_fence
from tests.fakes import fake_dataset
from tests.shared import made_once

PASSWORD = "correct horse"


def make_keys(folder: Path) -> None:
    folder.mkdir()
    for name in ("organiser", "somebody"):
        pair = minisign.KeyPair.generate()
        (folder / f"{name}.pub").write_bytes(bytes(pair.public_key) + b"\n")
        pair.secret_key.encrypt(PASSWORD, opslimit=32768, memlimit=2**20)  # the usual limits take a gigabyte
        (folder / f"{name}.key").write_bytes(bytes(pair.secret_key) + b"\n")
        (folder / f"{name}.key").chmod(0o600)


def words(data: Path, out: Path, key: Path) -> list[str]:
    settings = ["--method", "static", "--condition", "none", "--data", str(data), "--out", str(out)]
    return ["run", *settings, "--sign", str(key)]


@pytest.fixture
def keys() -> Path:
    return made_once("signing-keys", make_keys)


@pytest.fixture
def data() -> Path:
    return made_once("table-of-12", lambda path: fake_dataset(path, 12))


@pytest.fixture
def signed(keys, data, tmp_path, monkeypatch) -> Path:
    """A run that the organiser has signed."""

    def make(path: Path) -> None:
        monkeypatch.setenv(PASSWORD_VARIABLE, PASSWORD)
        assert main(words(data, path, keys / "organiser.key")) == 0

    return Path(shutil.copytree(made_once("signed-run", make), tmp_path / "runs" / "mine"))


def exported(*words: Path | str, by: Path) -> int:
    return main(["leaderboard", "export", *map(str, words), "--require-signed", str(by)])


def test_a_board_of_signed_runs_names_the_key_and_score_does_too(signed, keys, data, capsys):
    assert exported(signed, by=keys / "organiser.pub") == 0
    signer = f"{int.from_bytes(minisign.PublicKey.from_file(keys / 'organiser.pub')._keynum_pk.key_id, 'little'):016X}"
    assert f"All runs are signed by {signer}" in capsys.readouterr().out
    for format, shown in (("csv", f",{signer}"), ("json", f'"signed_by": "{signer}"')):
        assert exported(signed, "--format", format, by=keys / "organiser.pub") == 0
        assert shown in capsys.readouterr().out
    assert main(["score", str(signed), "--data", str(data), "--require-signed", str(keys / "organiser.pub")]) == 0
    assert f"signed by {signer}" in capsys.readouterr().err
    assert main(["score", str(signed), "--data", str(data)]) == 0
    assert "the run is signed; --require-signed" in capsys.readouterr().err


OF_THE_DATASET = ("summary.json", "scores.parquet", "cost.json", "agreement.json", "predictions/part-00000.parquet")
OF_THE_RUN = ("run.json", "SHA256SUMS", "SHA256SUMS.minisig")


@pytest.mark.parametrize("name", [*OF_THE_RUN, *(f"synthetic-adt/{name}" for name in OF_THE_DATASET)])
@pytest.mark.parametrize("lost", [False, True])
def test_no_file_of_a_signed_run_can_be_edited_or_taken_away(signed, keys, name, lost, capsys):
    file = signed / name
    content = file.read_bytes()
    file.unlink()
    if not lost:
        edited = content[:-2] + b"x" + content[-1:]
        file.write_bytes(content.replace(b"static", b"statue") if name == "run.json" else edited)
    assert exported(signed, by=keys / "organiser.pub") != 0
    told = capsys.readouterr().err
    assert str(signed) in told
    assert Path(name).name in told or "is not signed" in told or "does not hold" in told


def test_a_file_added_after_signing_and_every_wrong_run_are_named(signed, keys, capsys):
    added = Path(shutil.copytree(signed, signed.parent / "added"))
    (added / "synthetic-adt" / "predictions" / "part-00001.parquet").write_bytes(b"")
    (bare := Path(shutil.copytree(signed, signed.parent / "bare"))).joinpath("SHA256SUMS.minisig").unlink()
    assert exported(signed.parent, by=keys / "organiser.pub") == 7
    told = capsys.readouterr().err
    assert f"{added}: synthetic-adt/predictions/part-00001.parquet was changed, added or removed" in told
    assert f"{bare}: is not signed" in told
    assert f"{signed}: " not in told
    assert exported(signed, by=keys / "somebody.pub") == 7
    assert f"{signed}: is signed by" in capsys.readouterr().err


def test_what_lies_there_is_signed_as_such_and_never_with_an_isolation_that_did_not_hold(
    signed, keys, data, capsys, monkeypatch
):
    (keys / "somebody.key").chmod(0o644)
    command = words(data, signed, keys / "somebody.key")
    monkeypatch.setenv(PASSWORD_VARIABLE, PASSWORD)
    assert main(command) == 0
    told = capsys.readouterr().err
    assert "others of this machine can read the secret key; `chmod 600" in told
    assert "0 of 1 batches were made just now" in told
    assert "isolation none, 0 of 1 batches" in (signed / "SHA256SUMS.minisig").read_text()
    assert exported(signed, by=keys / "somebody.pub") == 0
    record = signed / "run.json"
    record.write_text(record.read_text().replace('"isolation": null', '"isolation": "bubblewrap"'))
    monkeypatch.setenv(PASSWORD_VARIABLE, PASSWORD)
    assert main(command) == 7
    assert "isolation: expected nothing for this run, found bubblewrap" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "code", "told"),
    [
        ({"password": "wrong"}, 2, "wrong password for that key"),
        ({}, 2, f"expected a terminal to ask for the key's password, or {PASSWORD_VARIABLE}"),
        ({"key": "organiser.pub"}, 3, "organiser.pub: expected a secret key of minisign, of"),
        ({"key": "absent.key"}, 3, "absent.key: expected a secret key of minisign, of"),
        ({"method": "cmd:python glide.py"}, 2, "--sign: 'python glide.py' could take the key. Add --isolate"),
        ({"method": "all"}, 2, "--sign: belongs to a run of one method"),
        ({"shard": "1/2"}, 2, "--shard 1/2: does not go with --sign"),
    ],
)
def test_a_key_that_cannot_sign_is_told_before_the_run(keys, data, tmp_path, change, code, told, capsys, monkeypatch):
    if "password" in change:
        monkeypatch.setenv(PASSWORD_VARIABLE, change["password"])
    command = words(data, tmp_path / "run", keys / change.get("key", "organiser.key"))
    command[2] = change.get("method", "static")
    command += ["--shard", change["shard"]] if "shard" in change else []
    assert main(command) == code
    assert told in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_the_common_tools_check_a_signed_run(signed, keys):
    subprocess.run(["sha256sum", "--strict", "-c", "SHA256SUMS"], cwd=signed, check=True)
    if shutil.which("minisign") is None:
        pytest.skip("minisign is not installed")
    subprocess.run(["minisign", "-Vm", "SHA256SUMS", "-p", keys / "organiser.pub"], cwd=signed, check=True)


def test_require_fence_refuses_where_nothing_withholds_the_file_system(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    available_fence.cache_clear()
    command = [*words(data, tmp_path / "run", Path())[:-2], "--require-fence"]
    assert main(command) == 2
    told = capsys.readouterr().err
    assert "'static' could read all your files: bubblewrap is not installed. Install bubblewrap" in told
    assert not (tmp_path / "run").exists()
    monkeypatch.undo()
    available_fence.cache_clear()
    if available_fence().program is not None:
        assert main(command) == 0
        assert json.loads((tmp_path / "run" / "run.json").read_text())["method"]["isolation"] == "bubblewrap"
