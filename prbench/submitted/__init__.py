"""Motions that were made elsewhere: conditions for offline generation, finished predictions, stored scores."""
