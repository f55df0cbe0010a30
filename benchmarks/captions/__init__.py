"""Captions of motions against references: metrics of text, files of captions and of motion tokens, and a table."""
