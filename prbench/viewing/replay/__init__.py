"""Recorded and generated motions of the same sequences, shown beside one another: PNG, MP4 and HTML."""
