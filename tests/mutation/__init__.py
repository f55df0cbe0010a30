"""Small mistakes are put into the code, and the package's tests must notice them (``docs/reliability.md``)."""
