"""The prime-and-reach benchmark: its protocol, published numbers and ablations."""
