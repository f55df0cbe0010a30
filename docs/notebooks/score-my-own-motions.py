# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Score my own motions
#
# You have a method that generates human motion, and its results as arrays. This notebook turns them into scores that
# can be compared with those of other methods. Arrays are all it needs: how they were made does not matter.
#
# It takes about fifteen seconds. The people are synthetic, so that no data is needed; never compare these scores with
# published ones.

# %%
import tempfile
from pathlib import Path

import numpy as np

import prbench

folder = Path(tempfile.mkdtemp(prefix="prbench-notebook-"))
recordings = prbench.synthesize("adt", folder / "recordings", count=4, seed=1)
table = prbench.build_dataset("adt", recordings.folder, folder / "tables" / "adt").table
table

# %% [markdown]
# With a table of your own the cell above is one line: `table = prbench.open_table("tables/adt")`.
#
# ## What has to be generated
#
# A table is divided into parts (*splits*): `train` to learn from, `validation` to choose by, `test` to be judged on.
# Which part a recording belongs to is fixed. This small table may have no test recordings, so we take the part with
# the most sequences; for real results it is always `test`.

# %%
split = table.to_pandas().split.value_counts().idxmax()
ids = table.sequence_ids(split=split)
print(split, len(ids), "sequences")

# %% [markdown]
# Your method knows where each body starts, where the object is, and how many frames it has to make. It gives back joint
# positions (n, 22, 3): `n` frames, 22 joints in the order of `prbench.Joint`, metres. Here stands a very simple method:
# it slides the first pose along a straight line until the pelvis stands 40 cm before the goal.


# %%
def slide(sequence: prbench.Sequence) -> np.ndarray:
    """Slide the first pose towards the goal at constant speed."""
    first = sequence.joints[0].astype(np.float64)
    way = sequence.goal.location - first[prbench.Joint.PELVIS]
    way[1] = 0.0  # stay on the ground
    distance = np.linalg.norm(way)
    way *= max(1 - 0.4 / max(distance, 1e-9), 0)
    share = np.linspace(0, 1, sequence.n_frames)
    return first + share[:, None, None] * way


motions = {sequence.sequence_id: slide(sequence) for sequence in table.sequences(split=split)}
motions[ids[0]].shape

# %% [markdown]
# ## Scores
#
# `score` compares each motion with the recorded one and with the goal. Six numbers are the study's own:
#
# * **Prime Success**: does the head turn to the goal around the time at which the recorded person first looked there?
# * **Reach Success**: does a wrist come within 10 cm of the goal?
# * **Goal MPJPE**: how far are the 22 joints from the recorded ones in the last frame, on average, in metres?
# * **Location Error**: does the body end half a metre or more from where the recorded one ended?
# * **MPJPE**: how far are the joints from the recorded ones over all frames, on average, in metres?
# * **Foot Skating**: in which share of the frames does a foot slide over the floor?
#
# The interval says how far the mean could be off by chance, given how few recordings there are.

# %%
scores = prbench.score(motions, table, split=split, name="slide", out=folder / "scores" / "slide")
scores

# %% [markdown]
# A motion that is missing, or of a sequence that is unknown, is refused by name, because a mean over other sequences
# could not be compared.

# %%
incomplete = dict(list(motions.items())[1:])
try:
    prbench.score(incomplete, table, split=split)
except prbench.PrbenchError as error:
    print(error)

# %% [markdown]
# ## Which sequences are hard?
#
# The long form has one row a sequence and metric.

# %%
rows = scores.to_pandas()
wide = rows.pivot(index="sequence_id", columns="metric", values="value")
wide.sort_values("goal_mpjpe", ascending=False)[["goal_mpjpe", "mpjpe", "reach_success"]].head()

# %% [markdown]
# ## In company
#
# What is a score worth? `static` is a method that repeats one mean pose. `compare` looks at both sequence by sequence,
# and says whether the data support a difference. With few recordings the honest answer is often that they do not.

# %%
static = prbench.run("static", data=table, split=split, out=folder / "runs" / "static")
prbench.compare(scores, static, data=table)

# %% [markdown]
# ## Arrays without a table
#
# `measure` computes the same metrics for arrays of your own. What you do not give is left out and named.

# %%
sequence = table.sequence(ids[0])
measures = prbench.measure(motions[ids[0]], recorded=sequence.joints, fps=sequence.fps)
measures

# %%
measures = prbench.measure(
    motions[ids[0]],
    recorded=sequence.joints,
    goal_location=sequence.goal.location,
    prime_time=sequence.prime_after,
    head_tilt_deg=sequence.head_tilt_deg,
    fps=sequence.fps,
)
assert not measures.left_out
assert measures["goal_mpjpe"] < 10
measures
