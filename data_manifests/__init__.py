"""One TOML file a dataset: where it comes from, what it holds and how it is read. Data only."""
