"""The benchmarks: protocols, published numbers, and what belongs to one of them alone."""
