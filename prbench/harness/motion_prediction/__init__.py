"""Motion prediction as a benchmark: its windows, what a predictor may know of them, and what judges its futures."""
