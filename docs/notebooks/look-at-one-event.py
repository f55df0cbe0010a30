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
# # Look at one event
#
# A table of 323 sequences came from 402 events. What about the others? And is this sequence right, in which somebody
# seems to reach into the air? Before you trust a table, look at some of its events. This notebook shows how, in about
# ten seconds. The people in it are synthetic.

# %%
import tempfile
from pathlib import Path

import prbench

folder = Path(tempfile.mkdtemp(prefix="prbench-notebook-"))
recordings = prbench.synthesize("adt", folder / "recordings", count=3, seed=1, events=8)
table = prbench.build_dataset("adt", recordings.folder, folder / "tables" / "adt").table

# %% [markdown]
# An *event* is a moment at which an object is picked up or put down. The column `outcome` says what became of it:
# `sequence`, or the reason why it became none.

# %%
events = table.events.to_pandas()
events[["object_name", "action", "hand", "event_time", "prime_time", "outcome", "stage"]]

# %%
events.outcome.value_counts()

# %% [markdown]
# ## One that became a sequence
#
# `explain` takes an event's id or any part of it that fits one event only. It lists the stages of curation with their
# numbers and draws them: when the eyes first met the object's place (*prime*), when the hand got there, and how the
# body moved.

# %%
accepted = events[events.outcome == "sequence"].iloc[0]
story = table.explain(accepted.event_id)
story

# %% [markdown]
# The stages as a dictionary, for programs:

# %%
story.stages

# %% [markdown]
# ## One that did not
#
# The story ends at the stage that stopped it, with the number that decided and the limit that it was compared with.

# %%
dropped = events[events.outcome != "sequence"]
if len(dropped):
    print(table.explain(dropped.iloc[0].event_id))
else:
    print("all events became sequences; build more recordings")

# %% [markdown]
# ## The motion
#
# The sequence of the accepted event, as a picture. In the left one of the three diagrams the orange line (gaze) comes
# down to the goal at the dashed line, which is the prime time, and the black one (head) follows. In the right one a
# hand comes near the goal at the end.

# %%
sequence = table.sequence(accepted.sequence_id)
sequence.plot()

# %% [markdown]
# The same in 3-D: drag to turn, press play.

# %%
sequence.replay()

# %% [markdown]
# ## By hand
#
# Everything in the pictures stands in the arrays. When do the eyes meet the goal? For each valid frame: the angle
# between the gaze and the direction from the eyes to the goal.

# %%
import numpy as np

towards = sequence.goal.location - sequence.gaze.origin
towards /= np.linalg.norm(towards, axis=1, keepdims=True)
angle = np.degrees(np.arccos(np.clip((towards * sequence.gaze.direction).sum(axis=1), -1, 1)))
prime_frame = round(sequence.prime_after * sequence.fps)
print(f"prime time: {sequence.prime_after:.2f} s after the first frame, gaze {angle[prime_frame]:.1f}° from the goal")
assert sequence.gaze.valid.any()
angle[max(prime_frame - 5, 0) : prime_frame + 5].round(1)
