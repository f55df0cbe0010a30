"""``python -m prbench``: the command line without the console script."""

import sys

from prbench.cli import main

sys.exit(main())
