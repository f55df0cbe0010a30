"""The converters are NumPy: torch is not imported."""

from __future__ import annotations

import subprocess
import sys


def test_importing_the_converters_imports_no_torch() -> None:
    code = "import sys, prbench.representation.converters; print({'torch'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
