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
# # From a recording to a table
#
# Somebody wears glasses that record where the person is and where the eyes look. The person walks through a kitchen,
# takes a cup, and puts it somewhere else. A method that generates human motion has to do the same: look at the cup
# first, walk to it, reach for it. To train and to test such a method we need many short pieces of motion that all
# begin shortly before the look and end with the grasp.
#
# This notebook makes such pieces. It takes about fifteen seconds and needs no data, because the people in it are
# synthetic: prbench acts out movements, and writes them in the very files that a real dataset has. With a dataset of
# your own you leave out the first step.

# %%
import tempfile
from pathlib import Path

import prbench

folder = Path(tempfile.mkdtemp(prefix="prbench-notebook-"))

# %% [markdown]
# ## Recordings
#
# `synthesize` writes three recordings in the layout of *Aria Digital Twin*, a dataset in which the glasses, the body
# and every object were tracked. `seed` chooses which people and kitchens; another seed gives others.

# %%
recordings = prbench.synthesize("adt", folder / "recordings", count=3, seed=1)
recordings.to_pandas()

# %% [markdown]
# These are the files of one recording: poses of the glasses, gaze, the body, the objects and their boxes.

# %%
first = recordings.folder / recordings.to_pandas().recording_id[0]
sorted(path.relative_to(first).as_posix() for path in first.rglob("*") if path.is_file())

# %% [markdown]
# ## From recordings to sequences
#
# `build_dataset` reads the recordings and looks for *events*: a moment at which an object is picked up or put down.
# For each event it asks a chain of questions:
#
# 1. **located**: is it known where the object was (for a put: where it will be)?
# 2. **primed**: did the eyes meet that place in the 10 seconds before? The first time they did is the *prime time*. The
#    study that prbench follows found that people look at the goal before they go there, and calls this *priming*.
# 3. **long enough**: does the recording cover the 2 seconds before the prime time, with the body known all the time?
# 4. **moved enough**: were both hands at least 20 cm from the goal at the beginning? Otherwise there is nothing to
#    generate.
#
# What passes all questions becomes a *sequence*: the motion from 2 seconds before the prime time to the event.

# %%
build = prbench.build_dataset("adt", recordings.folder, folder / "tables" / "adt")
build

# %% [markdown]
# Nothing disappears silently: the column `why` says what was dropped and for which reason. Recordings that could not be
# read would stand in `build.unread`.

# %%
build.unread

# %% [markdown]
# ## Into the table
#
# The table is a folder of Parquet files, which pandas, polars and DuckDB open as well. prbench opens it with checks: an
# edited or damaged file is refused by name.

# %%
table = prbench.open_table(folder / "tables" / "adt")
table

# %% [markdown]
# One row a sequence. `prime_gap` is the time from the first look at the goal to the event, in seconds; `split` says
# whether a sequence belongs to training or to the test.

# %%
frame = table.to_pandas()
frame[["action", "object_name", "hand", "n_frames", "prime_gap", "split"]]

# %%
frame.groupby("action").prime_gap.describe()[["count", "mean", "min", "max"]]

# %% [markdown]
# ## One sequence
#
# `joints` holds 22 points of the body in every frame, in metres. They stand in the *canonical frame* of the sequence:
# Y is up, the pelvis of the first frame stands over the origin and faces +Z.

# %%
sequence = table[0]
sequence

# %%
sequence.joints.shape, sequence.joints[0, prbench.Joint.PELVIS].round(3)

# %% [markdown]
# How far is each hand from the goal at the end? One of them should be near.

# %%
import numpy as np

hands = [prbench.Joint.LEFT_WRIST, prbench.Joint.RIGHT_WRIST]
distance = np.linalg.norm(sequence.joints[-1, hands] - sequence.goal.location, axis=1)
print(f"left wrist {distance[0]:.2f} m, right wrist {distance[1]:.2f} m from the goal; the hand is {sequence.hand}")
assert distance.min() < 0.5

# %% [markdown]
# The picture shows poses over time: the orange line is the gaze, the dashed line where the head points, and the blue
# box the goal (or a blue arrow points to it, where it is too far away). On the right is the way from above. The
# curves tell how far the head ray, the gaze and the hands are from the goal; the dashed vertical line is the prime
# time.

# %%
sequence.plot()

# %% [markdown]
# `sequence.replay()` shows the same in 3-D, to turn and play.
#
# ## Events that became no sequence
#
# The table keeps them too, with the question that stopped them.

# %%
events = table.events.to_pandas()
events.outcome.value_counts()

# %% [markdown]
# `look-at-one-event.py` looks into one of them. `score-my-own-motions.py` shows how motions are scored on a table.
