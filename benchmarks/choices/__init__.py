"""What the protocol's choices change, measured on the embedded data."""
