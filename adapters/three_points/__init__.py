"""Bodies from the poses of head and wrists: the learnt trackers of the benchmark three-points."""
