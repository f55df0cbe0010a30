"""Methods that are programs of their own: ``cmd:`` commands and TOML files, turned into how they are started."""

from prbench.harness.methods.programs.start import MethodProgram, own_environment, program_of, runs_in_container
from prbench.harness.methods.programs.words import is_program, short_name

__all__ = ["MethodProgram", "is_program", "own_environment", "program_of", "runs_in_container", "short_name"]
