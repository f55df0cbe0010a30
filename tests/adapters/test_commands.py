"""``prbench train`` as a user meets it, with a toy for a network."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from prbench.cli import main
from prbench.errors import TrainingError, UsageError
from prbench.files.storage import file_digest, read_json
from prbench.sequences import SequenceTable
from prbench.sequences.folds import participant_folds
from prbench_adapters.training.dataset import SequenceDataset
from prbench_adapters.training.store import REFIT
from prbench_adapters.training.weights import read_weights
from tests.adapters.training.toy import SIGNAL_VARIABLE, entry_points_of
from tests.cli.reports import refused, reported
from tests.fakes import fake_dataset

ROOT = Path(__file__).parents[2]
VALIDATED = ["--set", "validation.every=4", "--set", "validation.sequences=3"]
SCRIPT = """
import sys
import prbench.harness.methods.installed
from tests.adapters.training.toy import entry_points_of
prbench.harness.methods.installed.entry_points_of = entry_points_of
from prbench.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.fixture(autouse=True)
def toy_is_installed(monkeypatch, tmp_path_factory):
    monkeypatch.setattr("prbench.harness.methods.installed.entry_points_of", entry_points_of)
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path_factory.getbasetemp() / "train-cache"))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return fake_dataset(tmp_path_factory.mktemp("table") / "data", 24).folder


def command(data, out, *more):
    return ["train", "--method", "toy", "--data", str(data), "--out", str(out), *more]


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """A finished training, and what it printed to standard output and standard error."""
    out = tmp_path_factory.mktemp("trained")
    printed, said = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("prbench.harness.methods.installed.entry_points_of", entry_points_of)
        patch.setenv("PRBENCH_CACHE", str(tmp_path_factory.getbasetemp() / "train-cache"))
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
            assert main(command(data, out, *VALIDATED)) == 0, said.getvalue()
    return out, printed.getvalue(), said.getvalue()


def test_the_second_world_is_never_learnt_from(tmp_path, capsys):
    words = ["synthesize", "adt", "--table", "--world", "second", "--count", "1", "--events", "2"]
    assert main([*words, "--out", str(tmp_path / "second")]) == 0
    message = "holds synthetic-second-adt, whose people are for tests of transfer and never learnt from"
    refused(command(tmp_path / "second", tmp_path / "out"), capsys, code=2, message=message)


def test_a_training_prints_lines_and_leaves_weights_a_card_and_a_log(trained, data):
    out, printed, said = trained
    card = read_json(out / "weights.json")
    best = min(card["validation"], key=lambda row: row["loss"])["step"]
    assert printed == f"weights: {out / 'weights.safetensors'} (of the best validation, after {best} of 8 steps)\n"
    lines = said.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "step 2/8", "step 4/8", "validation at 4", "step 6/8", "step 8/8", "validation at 8",
    ]  # fmt: skip
    assert "loss " in lines[0]
    assert "root " in lines[2]
    assert (card["method"], card["stage"]) == ("toy", "pretrain")
    assert (card["finished"], card["steps"], card["best_step"], card["devices"]) == (True, 8, best, 1)
    assert card["configuration"]["model"] == {"width": 6}
    assert card["weights_sha256"] == file_digest(out / "weights.safetensors")
    assert card["parameters"] == 263 * 6 + 6 + 6 * 263 + 263
    assert card["learned_from"] == ["nothing much"]
    assert [row["step"] for row in card["learning_curve"]] == [2, 4, 6, 8]
    assert {"python", "torch", "lightning-fabric"} <= card["packages"].keys()
    assert card["device"].startswith("cpu")
    (table,) = card["data"]
    assert table["dataset"] == "synthetic-adt"
    assert table["sequences"] == 12
    assert table["content_digest"] == read_json(data / "dataset.json")["content_digest"]
    assert card["validation"][-1].keys() == {"step", "loss", "root"}
    assert list((out / "tensorboard").glob("events.out.tfevents.*"))
    assert read_weights(out / "weights.safetensors", kind="toy").metadata["configuration"] == '{"width":6}'


def test_a_killed_training_goes_on_by_the_same_command_to_the_same_weights(trained, data, tmp_path, capsys):
    reference, *_ = trained
    killed = subprocess.run(
        [sys.executable, "-c", SCRIPT, *command(data, tmp_path / "out")],
        cwd=ROOT,
        env={**os.environ, SIGNAL_VARIABLE: "4:SIGKILL"},
    )
    assert killed.returncode == -signal.SIGKILL
    assert sorted(path.name for path in (tmp_path / "out" / "checkpoints").iterdir())[-1] == "step-000000003"
    assert main(command(data, tmp_path / "out")) == 0
    assert "step 4/8" in capsys.readouterr().err, "lines go on after the last checkpoint"
    assert (tmp_path / "out" / "weights.safetensors").read_bytes() == (reference / "weights.safetensors").read_bytes()


def test_sigterm_saves_says_so_and_the_same_command_goes_on(trained, data, tmp_path, capsys, monkeypatch):
    reference, *_ = trained
    monkeypatch.setenv(SIGNAL_VARIABLE, "4:SIGTERM")
    assert main(command(data, tmp_path / "out")) == 143
    error = capsys.readouterr().err
    assert "stopped after step 5 of 8; everything is saved. The same command goes on from there." in error
    assert "Traceback" not in error
    assert not read_json(tmp_path / "out" / "weights.json")["finished"]
    monkeypatch.delenv(SIGNAL_VARIABLE)
    assert main(command(data, tmp_path / "out")) == 0
    assert (tmp_path / "out" / "weights.safetensors").read_bytes() == (reference / "weights.safetensors").read_bytes()


@pytest.mark.parametrize(
    ("more", "key"),
    [
        (["--set", "model.width=9"], "'configuration.model.width' is 6 there, but 9"),
        (["--stage", "finetune"], """'stage' is "pretrain" there, but "finetune\""""),
    ],
)
def test_another_training_in_the_same_folder_is_refused(more, key, trained, data, capsys):
    out, *_ = trained
    before = (out / "training.json").read_bytes()
    assert main(command(data, out, *VALIDATED, *more)) == 11
    assert key in capsys.readouterr().err
    assert (out / "training.json").read_bytes() == before


def test_a_training_starts_from_given_weights(trained, data, tmp_path):
    out, *_ = trained
    more = ["--stage", "finetune", "--set", "model.width=6", "--init", str(out / "weights.safetensors")]
    assert main(command(data, tmp_path / "out", *more)) == 0
    card = read_json(tmp_path / "out" / "weights.json")
    assert card["initial_weights_sha256"] == file_digest(out / "weights.safetensors")
    assert card["stage"] == "finetune"


def test_the_configuration_can_be_printed_and_used_as_a_file(tmp_path, capsys):
    assert (
        main(["train", "--method", "toy", "--stage", "finetune", "--show-config", "--set", "data.max_frames=30"]) == 0
    )
    printed = capsys.readouterr().out
    assert "max_frames = 30" in printed
    file = tmp_path / "own.toml"
    file.write_text(printed)
    assert main(["train", "--method", "toy", "--config", str(file), "--show-config", "--stage", "finetune"]) == 0
    assert capsys.readouterr().out == printed.replace("width = 6", "width = 7")
    report = reported(["train", "--method", "toy", "--config", str(file), "--show-config"], capsys)
    assert report.trained is None
    assert report.configuration is not None
    assert report.configuration["model"]["width"] == 7
    assert set(report.configuration) == {"model", "training", "data", "validation"}


def _foreign(tmp_path):
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "thesis.tex").write_text("x")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--method", "toi"], 5, "nothing to train is called 'toi'. Did you mean 'toy'? There are: toy."),
        (["--config", "smal"], 2, "'toy' has no configuration 'smal'. Did you mean 'small'? There are: small;"),
        (["--stage", "warmup"], 2, "'toy' has no stage 'warmup'; its stages are: pretrain, finetune."),
        (["--set", "training.step=3"], 3, "unknown field `step`"),
        (["--device", "cuda"], 2, "--device cuda: torch"),
        (["--device", "cuda:1", "--devices", "2"], 2, "names one device"),
        (["--device", "tpu"], 2, "expected cpu, cuda, cuda:1 … or mps, found 'tpu'"),
        (["--data", "{tmp}/nowhere"], 4, "found no such folder"),
        (["--out", "{tmp}/foreign"], 8, "holds no training.json"),
        (["--init", "{tmp}/nothing.safetensors"], 3, "no such file"),
        (["--init", "{tmp}/foreign/thesis.tex"], 3, "expected a safetensors file"),
        (["--set", "data.max_frames=1"], 2, "max_frames"),
    ],
)
def test_a_mistake_gives_one_message_and_its_exit_code(arguments, code, message, data, tmp_path, capsys):
    import torch

    if "cuda" in message and torch.cuda.is_available():
        pytest.skip("there is a GPU")
    _foreign(tmp_path)
    filled = [part.format(tmp=tmp_path) for part in arguments]
    assert main([*command(data, tmp_path / "out"), *filled]) == code
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists(), "the corrected command must not find another training there"


def test_a_finished_training_is_reported_as_json_and_data_and_out_are_asked_for(trained, data, capsys):
    refused(["train", "--method", "toy"], capsys, code=2, message="--data DIR is needed.")
    refused(["train", "--method", "toy", "--data", "a"], capsys, code=2, message="--out DIR is needed.")
    report = reported(command(data, trained[0], *VALIDATED), capsys)
    assert report.trained is not None
    assert report.trained.weights.is_file()
    assert (report.method, report.configuration, report.trained.steps) == ("toy", None, 8)


@pytest.mark.parametrize("package", ["lightning_fabric", "tensorboard"])
def test_without_the_extra_its_install_line_is_named(package, data, tmp_path, capsys, monkeypatch):
    for name in [name for name in sys.modules if name.split(".")[0] == package or name == "torch.utils.tensorboard"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert main(command(data, tmp_path / "out")) == 9
    assert "pip install 'prbench[train]'" in capsys.readouterr().err


def test_the_precision_is_timed_once_and_an_interrupted_training_goes_on_with_it(data, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr("prbench_adapters.training.run.faster_precision", lambda *_: asked.append(1) or "bf16-mixed")
    words = command(data, tmp_path / "out", "--set", "training.precision=auto")
    monkeypatch.setenv(SIGNAL_VARIABLE, "4:SIGTERM")
    assert main(words) == 143
    monkeypatch.delenv(SIGNAL_VARIABLE)
    assert main(words) == 0
    assert len(asked) == 1
    assert read_json(tmp_path / "out" / "weights.json")["configuration"]["training"]["precision"] == "bf16-mixed"


class FakeWandb:
    """Stands in for the package: one run by id, which goes on when it is opened again."""

    def __init__(self) -> None:
        self.logged, self.opened, self.finished = [], [], 0
        self.Settings = dict

    def init(self, **given):
        self.opened.append(given)
        return self

    def log(self, values, step):
        self.logged.append((step, *values))

    def finish(self):
        self.finished += 1


def test_lines_of_the_log_go_to_weights_and_biases_too_into_one_run(data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "out"
    words = command(data, out, *VALIDATED, "--wandb", "reaching")
    monkeypatch.setitem(sys.modules, "wandb", None)
    assert main(words) == 9
    assert "--wandb needs the package 'wandb'" in capsys.readouterr().err
    assert not out.exists()
    fake = FakeWandb()
    monkeypatch.setitem(sys.modules, "wandb", fake)
    monkeypatch.setenv(SIGNAL_VARIABLE, "4:SIGTERM")
    assert main(words) == 143
    monkeypatch.delenv(SIGNAL_VARIABLE)
    assert main(words) == 0
    first, second = fake.opened
    assert first == second, "the id is kept"
    assert (first["project"], first["name"], first["resume"], fake.finished) == ("reaching", "out", "allow", 2)
    assert first["config"]["configuration"]["training"]["steps"] == 8
    lines = [("train", "loss", "root", "learning_rate"), ("validation", "loss", "root")]
    train, validation = (tuple(f"{group}/{name}" for name in names) for group, *names in lines)
    steps = [(2, *train), (4, *validation), (4, *train), (6, *train), (8, *validation), (8, *train)]
    assert fake.logged == steps


def test_help_imports_neither_torch_nor_numpy():
    code = "import sys\nfrom prbench.cli import main\ntry: main(['train', '--help'])\nexcept SystemExit: pass\n"
    done = subprocess.run(
        [sys.executable, "-c", code + "print('MODULES', *sys.modules)"], capture_output=True, text=True, cwd=ROOT
    )
    text, _, modules = done.stdout.partition("MODULES")
    assert "example:\n  prbench train " in text
    assert not {"torch", "numpy", "lightning_fabric", "prbench_adapters.training"} & set(modules.split())


def test_refit_learns_from_train_and_validation(data, tmp_path, capsys):
    table = SequenceTable.open(data).with_sequences()
    rows = {split: table.scalars(split=split).num_rows for split in ("train", "validation")}
    assert all(rows.values()), "the fake table has sequences in both"
    both = command(data, tmp_path / "both", "--refit", "--set", "validation.every=0")
    assert main(both) == 0
    record = read_json(tmp_path / "both/training.json")
    assert record["refit"] is True
    assert record["data"][0]["sequences"] == sum(rows.values())
    assert main(command(data, tmp_path / "alone", "--set", "validation.every=0")) == 0
    assert read_json(tmp_path / "alone/training.json")["data"][0]["sequences"] == rows["train"]
    both_ids = set(SequenceDataset(table, split=REFIT).sequence_ids)
    parts = [set(SequenceDataset(table, split=split).sequence_ids) for split in rows]
    assert both_ids == parts[0] | parts[1]
    # The folder of one is never gone on with as the other.
    refused(both[:-3] + both[-2:], capsys, code=TrainingError.exit_code, message="holds another training")
    words = command(data, tmp_path / "out", "--refit", *VALIDATED)
    refused(words, capsys, code=UsageError.exit_code, message="measuring on it would say nothing")


def test_a_fold_is_learnt_from_without_its_people(tmp_path, capsys):
    table = fake_dataset(tmp_path / "table", 24)
    out = tmp_path / "out"
    fold = ["--fold", "1/3"]
    assert main([*command(table.folder, out), *fold]) == 0
    fold_of = participant_folds(table, 3)
    people = table.scalars()["participant_id"].to_pylist()
    rows = zip(people, table.scalars()["split"].to_pylist())
    learnt = sum(fold_of[person] != 1 and split != "validation" for person, split in rows)
    (told,) = read_json(out / "training.json")["data"]
    assert (told["fold"], told["sequences"]) == ("1/3", learnt)
    (card,) = read_json(out / "weights.json")["data"]
    assert card["fold"] == "1/3"
    other = [*command(table.folder, out), "--fold", "2/3"]
    refused(other, capsys, code=TrainingError.exit_code, message="holds another training")
    every = [*command(table.folder, out), "--fold", "participant"]
    refused(every, capsys, code=UsageError.exit_code, message="expected K/N, such as 2/6. All folds together are")
