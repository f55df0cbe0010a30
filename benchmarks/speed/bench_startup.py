"""Commands that only print, beside a program of click that holds one command, and Python itself.

Each is a process of its own, as a shell starts it.
"""

from __future__ import annotations

import subprocess
import sys

from benchmarks.speed.timing import Row, print_rows, timed

_BARE = "import click\n@click.command()\ndef bare():\n    '''Do nothing.'''\nbare(['--help'])"
_REPEATS = 10


def main() -> None:
    """Time the commands and print them beside their peers."""
    commands = {
        "prbench --help": ["-m", "prbench", "--help"],
        "prbench run --help": ["-m", "prbench", "run", "--help"],
        "prbench adapters list": ["-m", "prbench", "adapters", "list"],
        "import prbench": ["-c", "import prbench"],
        "a bare click program, --help": ["-c", _BARE],
        "python -c pass": ["-c", "pass"],
    }
    rows = [Row(name, timed(lambda words=words: _call(words), _REPEATS)) for name, words in commands.items()]
    print_rows("start-up, wall time of the fastest of ten processes", rows)


def _call(words: list[str]) -> None:
    subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main()
