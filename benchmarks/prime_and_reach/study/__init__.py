"""The study's tables and figures on one's own tables and runs (``prbench study``, docs/study.md)."""
