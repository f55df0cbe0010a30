"""How well a head's elevation follows from the condition, and what its error weighs in the loss of training."""
