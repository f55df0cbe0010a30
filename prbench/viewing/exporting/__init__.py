"""Motions in files that other tools open: one module a format, and the command that writes one file a motion."""
