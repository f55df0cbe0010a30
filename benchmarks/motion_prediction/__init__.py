"""The motion prediction benchmark: its protocol, and the rows of its tables. Data only."""
