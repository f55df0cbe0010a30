"""Recordings that lack a body, and bodies by EgoAllo (docs/specification/egoallo.md#time) or from head and wrists."""

from prbench.curation.poses.make import Outcome, instructions, make_poses, read_config
from prbench.curation.poses.states import PoseState, pose_states
from prbench.curation.poses.three_point import ThreePointOptions, make_bodies
