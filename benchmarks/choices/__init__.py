"""What the protocol's choices change, measured on synthetic recordings."""
