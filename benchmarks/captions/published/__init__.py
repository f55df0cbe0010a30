"""Numbers that the study printed. Data only."""
