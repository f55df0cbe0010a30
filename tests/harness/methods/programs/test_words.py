"""A command is split into words as the user's system does it, and recorded without the user's folders."""

from __future__ import annotations

import pytest

from prbench.errors import UsageError
from prbench.harness.methods.programs import is_program, short_name, shown_command, split_command


def test_words_of_a_posix_command_keep_what_is_quoted_together():
    text = """python 'my methods/glide.py' --title "a b" c\\ d"""
    assert split_command(text, where="", windows=False) == ("python", "my methods/glide.py", "--title", "a b", "c d")


def test_backslashes_of_a_windows_command_separate_folders():
    text = r'"C:\Program Files\Python\python.exe" C:\methods\glide.py --root D:\data\ ""'
    words = (r"C:\Program Files\Python\python.exe", r"C:\methods\glide.py", "--root", "D:\\data\\", "")
    assert split_command(text, where="", windows=True) == words


@pytest.mark.parametrize("text", ["", "   ", "''"])
def test_a_command_of_nothing_is_refused_with_an_example(text):
    with pytest.raises(UsageError, match=r'--method cmd:…: expected a command, such as cmd:"python glide.py"'):
        split_command(text, where="--method cmd:…", windows=False)


@pytest.mark.parametrize("windows", [False, True])
def test_a_quotation_that_is_not_closed_is_refused(windows):
    with pytest.raises(UsageError, match=r'every quotation to be closed, found: python "glide\.py'):
        split_command('python "glide.py', where="here", windows=windows)


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        (("python", "glide.py"), "python glide.py"),
        (("/home/me/envs/x/bin/python", "/home/me/glide.py"), "python glide.py"),
        (("node", "--cwd=/home/me/m", "--n=3", "~/glide.mjs"), "node --cwd=m --n=3 glide.mjs"),
        ((r"C:\Users\me\python.exe", "sub/glide.py"), "python.exe sub/glide.py"),
        (("python", "my glide.py"), "python 'my glide.py'"),
    ],
)
def test_a_recorded_command_tells_no_folders_of_the_machine(words, shown):
    assert shown_command(words) == shown


def test_methods_are_told_apart_by_their_form_and_never_called_by_a_path():
    assert [is_program(text) for text in ("static", "cmd:python glide.py", "a/Glide.TOML")] == [False, True, True]
    assert short_name("/home/me/methods/glide.toml") == "glide"
    assert short_name("cmd:  python   glide.py") == "python glide.py"
    assert short_name('cmd:"/home/me/bin/python" /home/me/glide.py') == "python glide.py"
    assert short_name("cmd:python glide.py" + " --more" * 20).endswith("--more …")
    assert short_name("static") == "static"
