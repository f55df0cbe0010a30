"""Gaze with the head of P&R: a small network of its own, which sees finished motions (docs/methods/pr.md#gaze)."""
