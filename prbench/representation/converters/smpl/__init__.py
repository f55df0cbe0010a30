"""SMPL, SMPL-H and SMPL-X parameters to the 22 joints (``formats/humanml3d.md`` section 7)."""
