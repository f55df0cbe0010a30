"""Pictures of sequences, recordings and runs."""
