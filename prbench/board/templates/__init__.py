"""The files that a new board starts with; ``<<name>>`` stands for a value of its ``board.toml``."""
