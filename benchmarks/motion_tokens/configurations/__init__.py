"""Training configurations of motion tokens."""
