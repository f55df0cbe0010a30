"""EgoAllo as a step: which recordings lack a body, and how to make one (docs/specification/egoallo.md#time)."""

from prbench.curation.poses.make import instructions, make_poses, read_config
from prbench.curation.poses.states import PoseState, pose_states
