"""The prime-and-reach benchmark: its protocol. Data only."""
