"""Reader of plain recordings, the form into which anybody's own recordings are brought (docs/own-recordings.md)."""
