"""Joints to 263 HumanML3D features and back (``formats/humanml3d.md``); torch only in :mod:`.tensors`."""
