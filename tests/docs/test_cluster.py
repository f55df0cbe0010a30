"""The job scripts of docs/examples/cluster: shell, YAML and every command in them are checked, SLURM's ones are run."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.curation.sources import folder_bytes
from tests.docs.test_maintenance import PYPROJECT
from tests.parsing import all_commands, parsed

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "examples" / "cluster"
SCRIPTS = sorted((*FOLDER.glob("*.sh"), *FOLDER.glob("*.slurm")))
MANIFESTS = sorted(FOLDER.glob("*.yaml"))
SBATCH_OPTIONS = {"job-name", "cpus-per-task", "mem", "time", "requeue", "open-mode", "output", "gres"}
"""Of sbatch(1), as far as the scripts use them."""
VALUES = {"METHOD": "static", "CONDITION": "none", "DEVICE": "cpu"}
"""What stands for a variable where not any word will do; the others become 1."""
SBATCH = """\
#!/usr/bin/env bash
# Stands for SLURM: runs a job at once, the tasks of an array one after the other.
set -euo pipefail
array=
for word in "$@"; do
  case $word in
    --parsable | --dependency=afterok:7) ;;
    --array=*) array=${word#--array=} ;;
    --*) echo "sbatch: $word" >&2; exit 1 ;;
    *) script=$word ;;
  esac
done
export SLURM_SUBMIT_DIR=$PWD
if [ -z "$array" ]; then bash "$script" >&2; fi
for SLURM_ARRAY_TASK_ID in $(seq ${array:+${array%-*} ${array#*-}}); do
  export SLURM_ARRAY_TASK_ID
  bash "$script" >&2
done
echo 7
"""


def manifests(path: Path) -> list:
    yaml = pytest.importorskip("yaml")
    return list(yaml.safe_load_all(path.read_text(encoding="utf-8")))


def containers(document: dict) -> list[dict]:
    if document["kind"] == "Job":
        return document["spec"]["template"]["spec"]["containers"]
    cluster = document["spec"]["rayClusterSpec"]
    groups = [cluster["headGroupSpec"], *cluster["workerGroupSpecs"]]
    return [container for group in groups for container in group["template"]["spec"]["containers"]]


def commands(text: str) -> list[list[str]]:
    """The words of every call of prbench, with something in place of each variable."""
    lines = (line.strip().removeprefix("allow_unreadable").strip() for line in text.replace("\\\n", " ").splitlines())
    called = [line.partition("||")[0] for line in lines if line.startswith("prbench ")]
    called = [re.sub(r"\$(\w+)|\$\{(\w+)[^}]*\}", lambda at: VALUES.get(at[1] or at[2], "1"), line) for line in called]
    return [shlex.split(line)[1:] for line in called]


def require_parsed(found: list[list[str]]) -> None:
    assert found
    engines = [name for option in all_commands()["build-dataset"].params for name in option.opts]
    for words in found:
        if "--engine" in words and "--engine" not in engines:
            pytest.skip("build-dataset has no --engine in this version")
        context = parsed(words)
        if context.params.get("shard"):
            assert context.params["shard"] == "1/1" or context.params["shard"].endswith("/16")


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_a_script_is_sound_shell(path):
    done = subprocess.run(["bash", "-n", str(path)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.slurm")), ids=lambda path: path.name)
def test_the_commands_of_a_job_are_prbenchs_and_its_options_slurms(path):
    text = path.read_text(encoding="utf-8")
    require_parsed(commands(text))
    options = set(re.findall(r"^##?SBATCH --([a-z-]+)", text, re.MULTILINE))
    assert options
    assert options <= SBATCH_OPTIONS


@pytest.mark.parametrize("path", MANIFESTS, ids=lambda path: path.name)
def test_a_manifest_names_its_volumes_and_calls_prbench(path):
    for document in manifests(path):
        assert {"apiVersion", "kind", "metadata", "spec"} <= set(document)
        for container in containers(document):
            assert container["image"].startswith("prbench")
            assert [mount["mountPath"] for mount in container["volumeMounts"]] == ["/data"]
        called = [document["spec"].get("entrypoint", "")]
        called += [text for container in containers(document) for text in container.get("args", ())]
        require_parsed(commands("\n".join(called)))


def test_pods_make_as_many_shards_as_they_name():
    build = manifests(FOLDER / "kubernetes-shards.yaml")[0]
    assert f'"$shard/{build["spec"]["completions"]}"' in containers(build)[0]["args"][0]


def test_containers_copy_what_there_is_and_install_extras_that_exist():
    dockerfile, definition = ((FOLDER / name).read_text(encoding="utf-8") for name in ("Dockerfile", "prbench.def"))
    instructions = re.findall(r"^([A-Z]+) ", dockerfile, re.MULTILINE)
    assert instructions[0] == "FROM"
    assert set(instructions) <= {"FROM", "ARG", "WORKDIR", "COPY", "RUN", "ENV", "CMD"}
    assert re.findall(r"^Bootstrap: (\w+)\nFrom: (\S+)$", definition, re.MULTILINE) == [("docker", "python:3.11-slim")]
    assert {"files", "post", "runscript"} <= set(re.findall(r"^%(\w+)$", definition, re.MULTILINE))
    extras = [*re.findall(r"ARG EXTRAS=(\S+)", dockerfile), *re.findall(r'"\.\[([a-z,]+)\]"', definition)]
    assert {name for names in extras for name in names.split(",")} <= set(PYPROJECT["project"]["optional-dependencies"])
    assert (ROOT / "constraints.txt").is_file()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_the_slurm_jobs_end_in_the_table_the_run_and_the_board(tmp_path):
    def called(*words: object) -> None:
        done = subprocess.run(
            [str(word) for word in words], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr

    programs = tmp_path / "bin"
    programs.mkdir()
    for name, text in (("sbatch", SBATCH), ("prbench", f'#!/bin/sh\nexec "{sys.executable}" -m prbench "$@"\n')):
        (programs / name).write_text(text)
        (programs / name).chmod(0o755)
    shutil.copytree(FOLDER, tmp_path / "jobs")
    environment = os.environ | {
        "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "ROOT": str(tmp_path / "ADT"),
        "WORK": str(tmp_path / "work"),
        "SHARDS": "2",
    }
    called("prbench", "synthesize", "adt", "--count", 5, "--events", 2, "--out", tmp_path / "ADT")
    called("bash", tmp_path / "jobs" / "submit.sh")
    called("prbench", "build-dataset", "adt", "--root", tmp_path / "ADT", "--out", "table")
    called("prbench", "run", "--method", "static", "--condition", "none", "--data", "table", "--out", "run")
    assert folder_bytes(tmp_path / "work" / "tables" / "adt") == folder_bytes(tmp_path / "table")
    made, wanted = folder_bytes(tmp_path / "work" / "runs" / "static-none"), folder_bytes(tmp_path / "run")
    assert {name: made[name] for name in made if not name.endswith("cost.json")} == {
        name: wanted[name] for name in wanted if not name.endswith("cost.json")
    }
    assert "static" in (tmp_path / "work" / "board.md").read_text(encoding="utf-8")
