"""Bodies from the poses of head and wrists: protocol, tables of tracks, metrics and the study's Tables 3 and 4."""
