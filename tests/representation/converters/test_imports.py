"""The converters are NumPy: neither torch nor smplx is imported before somebody asks for smplx."""

from __future__ import annotations

import subprocess
import sys


def test_importing_the_converters_imports_no_torch() -> None:
    code = "import sys, prbench.representation.converters; print({'torch', 'smplx'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
