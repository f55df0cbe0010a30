"""Weights that come with MDM, each with its card; ``dno`` moves the noise of the same ones."""
