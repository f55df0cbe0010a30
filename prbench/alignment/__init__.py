"""One clock and one world for two trackers of one person: offset of clocks, and how a device sits on a segment."""
