"""Keep an installed method, or a user's program, at a distance: what it is shown, and what is withheld."""

from prbench.methods.isolation.bubblewrap import Fence, available_fence
from prbench.methods.isolation.environment import isolated_environment
from prbench.methods.isolation.isolated import fenced, worker_program

__all__ = ["Fence", "available_fence", "fenced", "isolated_environment", "worker_program"]
