"""Validated settings of every TOML file, and how errors in them are told."""
