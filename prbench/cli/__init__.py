"""The command line: one file a command group; each parses, calls one function and prints."""

from prbench.cli.main import main

__all__ = ["main"]
