"""prbench for notebooks and programs: what ``import prbench`` offers.

Names and defaults are those of the command line. Every path may be text or a :class:`pathlib.Path`, one value or a
list. Whatever a user can repair is raised as :class:`PrbenchError`, with the same text as on the command line.
"""

from prbench.api.building import Build, SyntheticRecordings, build_dataset, synthesize
from prbench.api.measuring import Measures, measure, measure_futures
from prbench.api.pictures import Picture, Replay
from prbench.api.priming import prime
from prbench.api.runs import Run, open_run, run
from prbench.api.scoring import Comparison, Scores, compare, score
from prbench.api.tables import (
    Event,
    Events,
    Gaze,
    Goal,
    Head,
    Recording,
    Recordings,
    Sequence,
    Story,
    Table,
    embedded_tables,
    open_table,
)
from prbench.curation.own_priming import PrimedEvent
from prbench.engine.choice import Cluster
from prbench.errors import PrbenchError
from prbench.geometry.skeleton import Joint
