"""Folders and files at URLs (``s3://…``), worked on as local copies in the cache folder (docs/object-stores.md)."""
