"""Instructions for whoever has not got EgoAllo yet: what to install and what to run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from prbench.readers.egoallo import format as ego
from prbench.readers.egoallo.model import HOW_TO_GET
from prbench.workflows.poses.states import PoseState

_INSTALL = """\
EgoAllo estimates bodies from the glasses' path; prbench reads its outputs and can run it, but does not contain it.
It needs Python 3.12 or newer and an NVIDIA GPU (repository brentyi/egoallo, MIT; commands of commit 0c20ae8):

  git clone https://github.com/brentyi/egoallo.git
  cd egoallo
  python3.12 -m venv .venv && . .venv/bin/activate
  pip install -e .
  pip install "jax[cuda12]==0.6.1" git+https://github.com/brentyi/jaxls.git
  bash download_checkpoint_and_data.sh        # 0.6 GB checkpoint, then 8 GB of examples that are not needed

"""

_CONFIG = """\
Then write a file, say egoallo.toml (paths are relative to it):

  [egoallo]
  python = "egoallo/.venv/bin/python"
  folder = "egoallo"
  model = "{model}"
  # command = ["{{python}}", "3_aria_inference.py", "--traj-root", "{{mps}}", "--traj-length", "{{frames}}",
  #            "--guidance-mode", "{{guidance}}", "--smplh-npz-path", "{{model}}"]      # this is the default
  # needs = ["vrs", "points"]                   # what of a recording the command cannot do without
  # timeout_minutes = 120                       # of one recording
  # environment = {{ CUDA_VISIBLE_DEVICES = "0" }}

and run:

  prbench poses egoallo --root {root} --config egoallo.toml

It prepares each recording (unpacks archives, turns ADT to Z up), runs the command, checks what comes out and moves it
to {target}. The same command resumes.

By hand instead: `prbench poses egoallo --root {root} --prepare` writes the prepared folders, then for each

  python 3_aria_inference.py --traj-root {by_hand} --traj-length FRAMES --guidance-mode MODE

whose outputs then lie where prbench looks.
"""


def instructions(root: Path, lacking: Sequence[PoseState]) -> str:
    """Commands that lead to the bodies which are lacking."""
    example = lacking[0].target if lacking else root / ego.POSES_FOLDER / "RECORDING" / ego.OUTPUT_FOLDER
    return (
        _INSTALL
        + HOW_TO_GET
        + "\n\n"
        + _CONFIG.format(root=root, target=example, by_hand=example.parent, model=ego.MODEL_FILE)
    )
