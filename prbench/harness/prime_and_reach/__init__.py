"""Prime-and-reach as a benchmark: its cases, what a method may know of them, and what judges its motions."""
