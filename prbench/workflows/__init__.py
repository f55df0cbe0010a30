"""Workflows that join curation and evaluation: from recordings to tables, from nothing to a first score."""
