"""Keep an installed method, or a user's program, at a distance: what it is shown, and what is withheld."""

from prbench.harness.methods.isolation.bubblewrap import Fence, available_fence
from prbench.harness.methods.isolation.environment import isolated_environment
from prbench.harness.methods.isolation.isolated import fenced, worker_program

__all__ = ["Fence", "available_fence", "fenced", "isolated_environment", "worker_program"]
