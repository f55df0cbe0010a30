"""The child's side of a check, which ``prbench.checking.conformance.session`` starts."""

import sys

from prbench.checking.conformance.session import run_ordered
from prbench.errors import PrbenchError

try:
    run_ordered()
except PrbenchError as error:
    sys.stderr.write(f"{error}\n")
    sys.exit(error.exit_code)
