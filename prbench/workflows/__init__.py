"""What strings the rivers together: from recordings to tables, from nothing to a first score."""
