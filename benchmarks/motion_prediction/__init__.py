"""The motion prediction benchmark: its protocol. Data only."""
