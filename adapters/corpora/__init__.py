"""Text-motion corpora for pre-training: Nymeria, HumanML3D and synthetic people, in one table."""
