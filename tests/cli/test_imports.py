"""Commands that only print load neither torch nor any method."""

from __future__ import annotations

import subprocess
import sys

import pytest

SCRIPT = """
import sys
from prbench.cli import main
try:
    main(sys.argv[1:])
except SystemExit:
    pass
print("MODULES", *sorted(sys.modules))
"""


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["run", "--help"], ["adapters", "list"]])
def test_neither_torch_nor_an_adapter_is_imported(arguments):
    done = subprocess.run([sys.executable, "-c", SCRIPT, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules = done.stdout.split("MODULES", 1)[1].split()
    assert "prbench.cli.main" in modules
    heavy = {"torch", "matplotlib", "scipy", "prbench_adapters"}
    light = {  # help shows the commands of packages
        "prbench_adapters",
        "prbench_adapters.commands",
        "prbench_adapters.corpora",
        "prbench_adapters.corpora.commands",
        "prbench_adapters.trained_network",
    }
    assert not [name for name in modules if name.split(".")[0] in heavy and name not in light]
    assert not {"numpy", "pyarrow", "pandas"} & set(modules), "help and lists must be quick"
