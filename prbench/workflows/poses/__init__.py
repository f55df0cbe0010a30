"""EgoAllo as a step: which recordings lack a body, and how to make one (docs/specification/egoallo.md#time)."""

from prbench.workflows.poses.config import instructions, read_config
from prbench.workflows.poses.make import make_poses
from prbench.workflows.poses.states import PoseState, pose_states

__all__ = ["PoseState", "instructions", "make_poses", "pose_states", "read_config"]
