"""Motion tokens: a VQ-VAE of motions, its training and reconstruction errors, and *Nymeria*'s Table 5."""
