"""prbench: curate prime-and-reach motion sequences, run motion generators over them and score the results."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("prbench")
except PackageNotFoundError:  # imported from a source tree that was never installed
    __version__ = "0.0.0+uninstalled"
