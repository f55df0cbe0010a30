"""The command line as a user meets it: help with examples, exit codes, one message for one mistake."""

from __future__ import annotations

import errno
import importlib
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest

from prbench import errors
from prbench.cli import main
from prbench.cli.commands import Group
from prbench.cli.main import program
from prbench.cli.options import FIRST_RUN_SEQUENCES
from prbench.cli.summaries import RunAnswer
from prbench.harness import first_run
from prbench.sequences import SequenceTable
from tests.cli.reports import documented
from tests.fakes import fake_dataset
from tests.parsing import all_commands, parsed

ROOT = Path(__file__).parents[2]
DIFFER = {"--out", "--condition", "--split", "--format", "--unit", "--events", "--by", "--fps", "--devices"}
"""Options whose value is a file in one command and a folder in another, or that one command offers ``all`` for, too.
`run` also has the split ``published``; formats are those of tables or of motions; units and events of files, too.
What is grouped by ``--by`` differs."""


@pytest.fixture
def data(tmp_path):
    return fake_dataset(tmp_path / "table", 24).folder


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (MemoryError("no"), 12, "table: the memory of this machine does not suffice (no)"),
        (RuntimeError("can't start new thread"), 12, "the memory of this machine does not suffice"),
        (OSError(errno.EFBIG, "File too large", "big.json"), 8, "big.json: larger than a file may be here"),
        (OSError(errno.ENOSPC, "No space left on device"), 8, "no space left on the device"),
    ],
)
def test_a_full_memory_or_disk_is_one_message_wherever_it_arises(error, code, said, data, capsys, monkeypatch):
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr(SequenceTable, "chunks", fail)
    assert main(["export-conditions", "--data", str(data), "--condition", "none", "--out", str(data / "c.npz")]) == code
    told = capsys.readouterr().err
    assert said in told
    assert "Traceback" not in told


def test_what_is_repeated_a_thousand_times_is_counted(data, capsys):
    for words, said in (
        (["run", "--method", "static", "--data", str(data), "--sequence", "abc" * 1000], "… (2800 more characters)"),
        (["leaderboard", "compare", *["runs/a"] * 1000], "runs/a (996 times)"),
    ):
        assert main(words) == 2
        told = capsys.readouterr().err
        assert said in told
        assert len(told) < 800


@pytest.mark.parametrize("name", [*all_commands(), "leaderboard", "adapters"])
def test_every_command_has_help_with_an_example_that_parses(name, capsys):
    assert main([*name.split(), "--help"]) == 0
    text = capsys.readouterr().out
    if name in all_commands():
        assert "example:\n  " in text
        parsed(shlex.split(all_commands()[name].example)[1:])


@pytest.mark.parametrize("width", [60, 80, 100])
def test_help_is_no_wider_than_the_terminal(width, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(width))
    for name in ["", *all_commands(), "leaderboard", "adapters"]:
        assert main([*name.split(), "--help"]) == 0
        assert [line for line in capsys.readouterr().out.splitlines() if len(line) > width] == [], name


def test_the_same_option_has_the_same_meaning_everywhere():
    """Where two commands have an option of one name, its value has one form."""
    forms: dict[str, set[str]] = {}
    for command in all_commands().values():
        for option in command.params:
            for spelling in option.opts:
                if spelling.startswith("--"):
                    form = f"{option.type.name} {getattr(option.type, 'choices', '')}"
                    forms.setdefault(spelling, set()).add(form)
    assert {spelling for spelling, found in forms.items() if len(found) > 1} == DIFFER


def test_nothing_asked_shows_the_commands_in_sections_and_fails(capsys):
    assert main([]) == 2
    text = capsys.readouterr().out
    for title in ("data: ", "run: ", "train: ", "board: ", "look: ", "develop: "):
        assert f"\n{title}" in text
    for name in all_commands():
        assert name.split()[0] in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rnu", "--method", "static"], "No such command 'rnu'. Did you mean 'run'?"),
        (["compare", "a", "b"], "Did you mean 'leaderboard compare'?"),
        (["leaderboard", "exprot"], "Did you mean 'export'?"),
        (["run", "--methd", "static"], "No such option '--methd'. (Did you mean one of: '--method'"),
        (["run", "--meth", "static"], "No such option '--meth'."),
        (["synthesize", "adt", "--recordings", "4"], "No such option '--recordings'. Did you mean '--count'?"),
        (["help", "inspect"], "`prbench COMMAND --help`"),
        (["run", "--condition", "goal-lok"], "'head+wrists', 'all'. Did you mean 'goal-loc'?"),
        (["score", "x.npz", "--data", "t", "--benchmark", "prime-reach"], "Did you mean 'prime-and-reach'?"),
        (["run", "--method"], "requires an argument"),
        (["inspect"], "Missing argument 'DIR...'"),
        (["run", "--option", "steps"], "expected key=value, found 'steps'"),
        (["run", "--method", "static", "--limit", "0"], "0 is not in the range x>=1"),
    ],
)
def test_a_misspelt_word_is_answered_with_the_nearest_one(words, message, capsys):
    assert main(words) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert "--help` lists what there is." in captured.err
    assert captured.out == ""


def test_a_run_shows_fifteen_options_first_and_all_others_as_advanced(capsys):
    assert main(["run", "--help"]) == 0
    first, _, advanced = capsys.readouterr().out.partition("\nOptions:\n")[2].partition("\nadvanced:\n")
    names = [
        [line.split()[0].rstrip(",") for line in part.splitlines() if line.startswith("  -")]
        for part in (first, advanced)
    ]
    assert len(names[0]) <= 15
    assert {"--method", "--condition", "--data", "--out"} <= set(names[0])
    options = {option.opts[0] for option in all_commands()["run"].params}
    assert options | {"--help"} == {*names[0], *names[1]}


def test_every_exit_code_of_an_error_is_on_its_page_which_help_names(capsys):
    assert main(["--help"]) == 0
    assert "docs/exit-codes.md" in capsys.readouterr().out
    raised = {each.exit_code for each in vars(errors).values() if isinstance(each, type) and hasattr(each, "exit_code")}
    page = (ROOT / "docs" / "exit-codes.md").read_text(encoding="utf-8")
    for code in {0, *raised, 130, 143}:
        assert f"\n| {code} | " in page


def test_quiet_leaves_notes_out_and_verbose_shows_the_traceback(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    words = ["run", "--method", "static", "--data", str(data), "--out", str(tmp_path / "run")]
    assert main(words) == 0
    assert "running static" in capsys.readouterr().err
    assert main([*words, "--quiet"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert "Prime Success" in captured.out
    assert main(["inspect", str(tmp_path / "nowhere"), "-v"]) == 3
    assert "Traceback" in capsys.readouterr().err, "the traceback of a user's error is there for those who ask for it"


def test_json_prints_one_document_whether_it_works_or_not(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    words = ["run", "--method", "static", "--data", str(data), "--out", str(tmp_path / "run"), "--json"]
    assert main(words) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["command"] == "run"
    report = documented(document["report"], RunAnswer)
    assert report.runs[0].datasets[0].metrics[0].title == "Prime Success"
    for refused, code in (["inspect", str(tmp_path / "nowhere"), "--json"], 3), (["inspect", "--json"], 2):
        assert main(refused) == code
        document = json.loads(capsys.readouterr().out)
        assert document["report"] is None
        assert document["exit_code"] == code
        assert document["error"]["message"]


def completed(kind: str, **words: str) -> str:
    environment = {**os.environ, "_PRBENCH_COMPLETE": kind, **words}
    return subprocess.run([sys.executable, "-m", "prbench"], capture_output=True, text=True, env=environment).stdout


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_completes_commands_and_options(shell):
    assert f"_PRBENCH_COMPLETE={shell}_complete" in completed(f"{shell}_source")
    place = "ru" if shell == "fish" else "1"
    assert "run" in completed(f"{shell}_complete", COMP_WORDS="prbench ru", COMP_CWORD=place)


@pytest.mark.parametrize(
    ("words", "found"), [("run --method sta", "static"), ("run --sam", "--samples"), ("le", "leaderboard")]
)
def test_values_options_and_commands_are_completed(words, found):
    place = str(len(words.split()))
    assert f",{found}\n" in completed("bash_complete", COMP_WORDS=f"prbench {words}", COMP_CWORD=place)


def test_a_run_prints_scores_with_intervals_and_says_synthetic(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "run"
    assert main(["run", "--method", "static", "--data", str(data), "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "synthetic" in text
    assert "Prime Success" in text
    assert "95 % interval" in text
    assert str(out) in text
    assert "stands still" in text, "Foot Skating of a motionless method is no number"
    assert (out / "synthetic-adt/summary.json").is_file()


def test_several_datasets_may_follow_one_option_or_repeat_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    one = fake_dataset(tmp_path / "one", 12, dataset="synthetic-one").folder
    two = fake_dataset(tmp_path / "two", 12, dataset="synthetic-two").folder
    for number, arguments in enumerate((["--data", str(one), str(two)], ["--data", str(one), "--data", str(two)])):
        out = tmp_path / f"run{number}"
        assert main(["run", "--method", "ground-truth", *arguments, "--out", str(out)]) == 0
        assert sorted(folder.name for folder in out.iterdir() if folder.is_dir()) == ["synthetic-one", "synthetic-two"]


def test_the_whole_way_from_run_to_leaderboard_and_score(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    run = tmp_path / "runs" / "truth"
    assert main(["run", "--method", "ground-truth", "--data", str(data), "--out", str(run)]) == 0
    assert main(["score", str(run), "--data", str(data), "--out", str(tmp_path / "scored")]) == 0
    assert (tmp_path / "scored" / "synthetic-adt/scores.parquet").read_bytes() == (
        run / "synthetic-adt/scores.parquet"
    ).read_bytes()
    capsys.readouterr()
    assert main(["leaderboard", "export", str(tmp_path / "runs"), "--format", "md"]) == 0
    printed = capsys.readouterr().out
    assert "| control | ground-truth |" in printed
    board = tmp_path / "board.csv"
    assert main(["leaderboard", "export", str(run), "--format", "csv", "--out", str(board)]) == 0
    assert board.read_text().startswith("table,dataset,condition,method")


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["run", "--method", "statik", "--data", "{data}"], 5, "Did you mean 'static'?"),
        (["run", "--method", "static", "--condition", "goal-loc", "--data", "{data}"], 5, "Choose one of: none."),
        (["run", "--method", "static", "--option", "speed=3", "--data", "{data}"], 5, "unknown option 'speed'"),
        (["run", "--method", "static", "--data", "{tmp}/nowhere"], 4, "expected a built dataset"),
        (["score", "{tmp}/missing.parquet", "--data", "{data}"], 6, "missing.parquet"),
        (["leaderboard", "export", "{tmp}"], 7, "found none"),
        (["run", "--method", "glid", "--data", "{data}"], 5, "Did you mean 'gmd'?"),
        (["run", "--method", "static", "--data", "{data}s"], 4, "found no such folder. Did you mean "),
        (["build-dataset", "adt", "--root", "{tmp}/nowhere", "--out", "{tmp}/x"], 3, "found no such folder"),
        (["build-dataset", "adt", "--root", "{tmp}"], 2, "--out DIR is needed"),
        (["build-dataset", "atd", "--root", "{tmp}", "--out", "{tmp}/x"], 2, "adt"),
        (["synthesize", "adt"], 2, "--out DIR is needed"),
        (["synthesize"], 2, "Missing argument 'LAYOUT'"),
        (["synthesize", "adt", "--size", "large", "--out", "{tmp}/x"], 2, "large"),
        (["synthesize", "unheard-of", "--out", "{tmp}/x"], 2, "adt"),
    ],
)
def test_a_mistake_gives_one_message_and_its_exit_code(arguments, code, message, data, tmp_path, capsys):
    filled = [part.format(data=data, tmp=tmp_path) for part in arguments]
    assert main(filled) == code
    errors = capsys.readouterr().err
    assert message in errors
    assert "Traceback" not in errors
    assert len(errors.strip().splitlines()) == 1
    assert not (tmp_path / "x").exists(), "nothing half-written stays"


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--method", "statc"], "Did you mean 'static'?"), (["--method", "pr"], "Choose one with --condition: goal-loc")],
)
def test_a_method_that_cannot_be_run_is_refused_before_the_embedded_table_is_built(
    words, message, tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("PRBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    assert main(["run", *words]) == 5
    captured = capsys.readouterr()
    assert message in captured.err
    assert "building" not in captured.err


# Where options mean the same, and what quick commands load.


def explained(command: str, option: str = "--limit") -> str:
    """What ``--help`` says about the option."""
    (found,) = [each for each in all_commands()[command].params if option in each.opts]
    return str(found.help)


def test_commands_that_count_the_same_explain_it_in_the_same_words() -> None:
    sequences = {explained(name).partition(" (default")[0] for name in ("run", "export-conditions", "score", "view")}
    assert sequences == {
        "At most N sequences of each dataset, of every recording its share, for every command the same"
    }
    recordings = {explained(name, "--max-recordings") for name in ("build-dataset", "build-corpus", "poses")}
    assert recordings == {"At most N recordings: the first by name."}


def test_the_help_of_a_run_tells_how_many_sequences_it_takes_without_data() -> None:
    assert first_run.SEQUENCES == FIRST_RUN_SEQUENCES
    assert f"{FIRST_RUN_SEQUENCES} without --data" in explained("run")


SCRIPT = "import sys; from prbench.cli import main; main(sys.argv[1:]); print('MODULES', *sorted(sys.modules))"


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["run", "--help"], ["adapters", "list"]])
def test_neither_torch_nor_an_adapter_is_imported(arguments):
    done = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules = done.stdout.split("MODULES", 1)[1].split()
    assert "prbench.cli.main" in modules
    heavy = {"torch", "matplotlib", "scipy", "prbench_adapters"}
    light = {  # help shows the commands of packages
        "prbench_adapters",
        "prbench_adapters.captions",
        "prbench_adapters.captions.commands",
        "prbench_adapters.commands",
        "prbench_adapters.corpora",
        "prbench_adapters.corpora.commands",
        "prbench_adapters.trained_network",
    }
    assert not [name for name in modules if name.split(".")[0] in heavy and name not in light]
    assert not {"numpy", "pyarrow", "pandas"} & set(modules), "help and lists must be quick"


# Commands of other packages, and former ones.


GREETING = """
import click
from prbench.cli.commands import command

@command("greet", example="prbench greet", section="look")
@click.argument("name")
def greet(name):
    '''Greet somebody.'''
    print("hello", name)

broken = 3
"""


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with a command, one that is none, one whose module is missing, and one that is called as ours."""
    info = tmp_path / "made-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: made\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[prbench.commands]\ngreet = made_commands:greet\nno-command = made_commands:broken\n"
        "absent = nowhere_to_be_found:x\nrun = made_commands:greet\nodd\n"
    )
    (tmp_path / "made_commands.py").write_text(GREETING)
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    program.__dict__.pop("_plugins", None)
    yield
    program.__dict__.pop("_plugins", None)


def test_a_command_of_a_package_is_listed_in_its_section_and_runs(package, capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    look = text.partition("look: ")[2].partition("\n\n")[0]
    assert "greet" in look
    assert "Greet somebody" in look
    assert main(["greet", "you"]) == 0
    assert capsys.readouterr().out == "hello you\n"
    assert main(["greet"]) == 2


@pytest.mark.parametrize(
    ("name", "problem"),
    [("no-command", "expected a Command or Group"), ("absent", "No module named 'nowhere_to_be_found'")],
)
def test_a_broken_command_breaks_itself_only(name, problem, package, capsys):
    assert main(["--help"]) == 0
    assert name not in capsys.readouterr().out
    assert main([name]) == 2
    error = capsys.readouterr().err
    assert f"the command '{name}' of the package made 1.0 cannot be used: " in error
    assert problem in error


def test_a_package_never_takes_the_place_of_a_command_of_prbench(package):
    assert all_commands()["run"].callback.__module__.startswith("prbench")


@pytest.mark.parametrize("former", program.renamed)
def test_a_former_command_names_the_present_one(former, capsys):
    if former in all_commands() or isinstance(program.get_command(None, former), Group):
        pytest.skip("not moved yet")
    assert main([*former.split(), "--json"]) == 2
    assert f"'prbench {former}' is now `prbench {program.renamed[former]}`." in capsys.readouterr().err


def test_a_section_without_commands_is_left_out():
    group = Group(
        "g",
        example="prbench diff a b",
        sections={"empty: nothing here": {}, "data: one": {"diff": "prbench.cli.view:diff"}},
    )
    text = group.get_help(click.Context(group, info_name="g"))
    assert "empty" not in text
    assert "data: one" in text


# Commands that pages and help show.


PAGES = "\n".join(
    path.read_text(encoding="utf-8")
    for path in (
        ROOT / "README.md",
        *sorted((ROOT / "docs").glob("*.md")),
        *sorted((ROOT / "docs" / "methods").glob("*.md")),
    )
)


def _shown_commands() -> list[str]:
    blocks = re.findall(r"```bash\n(.*?)```", PAGES, re.DOTALL)
    shown = [line.split("&&")[-1] for block in blocks for line in block.splitlines()]
    shown += re.findall(r"`(prbench [^`]+)`", PAGES)
    shown += [command.example for command in all_commands().values()]
    commands = (re.split(r" {2,}|#", line.strip())[0].strip() for line in shown)
    return sorted({command for command in commands if command.startswith("prbench ")})


NAMED_ONLY = (
    ["adapters", "check"],
    ["analyse", "diversity"],
    ["analyse", "errors"],
    ["doctor"],
    ["view"],
    ["explain", "--draw"],
    ["export-release"],
    ["run"],
    ["train"],
    ["run", "--config"],
    ["COMMAND", "--help"],
)
"""Named in running text, without what they need."""


def test_commands_are_found() -> None:
    assert len(_shown_commands()) > 12


@pytest.mark.parametrize("command", _shown_commands())
def test_a_shown_command_parses(command, monkeypatch) -> None:
    words = shlex.split(command)[1:]
    if words in NAMED_ONLY or " ".join(words) in all_commands():
        return
    parsed(words[: words.index(">")] if ">" in words else words)


@pytest.mark.parametrize("encoding", ["cp1252", "ascii"])
def test_help_survives_a_console_that_lacks_characters(encoding) -> None:
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    done = subprocess.run([sys.executable, "-m", "prbench", "run", "--help"], capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert b"Usage: prbench" in done.stdout
