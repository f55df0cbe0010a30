"""What the sensors of each dataset make of a performance: noise-free truth → native readings."""
