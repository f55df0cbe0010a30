"""The rows of the study's ablations, which are variants of this method (*Prime and Reach*, tables 3, 4 and S4 to S7).

``python -m prbench_adapters.pr.ablations [TABLE …]`` prints the commands that train and run them;
``prbench study ITEM --train`` runs them. The rows stand in ``benchmarks/prime_and_reach/ablations.toml``.
"""

from __future__ import annotations

import sys

from prbench_adapters.training.ablations import Ablation, load_ablations, main

__all__ = ["Ablation", "load_ablations", "main"]

if __name__ == "__main__":
    main(sys.argv[1:])
