"""Networks that predict motion: GazeMoDiff, HumanMAC, CVAE, DLow, BeLFusion; tensors in, tensors out."""
