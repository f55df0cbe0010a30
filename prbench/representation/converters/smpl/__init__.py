"""SMPL, SMPL-H and SMPL-X parameters to the 22 joints (docs/specification/humanml3d.md#body-model-parameters)."""
