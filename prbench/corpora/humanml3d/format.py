"""HumanML3D: names in its official folder and the form of its text lines.

Source: docs/specification/humanml3d.md#text-files.
"""

from __future__ import annotations

JOINTS_FOLDER = "new_joints"
"""Joint positions, one (F, 22, 3) array a motion: metres, Y up, 20 fps."""
FEATURES_FOLDER = "new_joint_vecs"
"""263 features a frame, one array a motion."""
TEXTS_FOLDER = "texts"
TEXTS_ARCHIVE = "texts.zip"
SPLIT_FILES = {"train": "train.txt", "validation": "val.txt", "test": "test.txt"}
MIRROR_PREFIX = "M"
RATE = 20.0
TEXT_SEPARATOR = "#"
"""``caption#tokens#from#to``; both times 0.0 mean the whole motion."""
