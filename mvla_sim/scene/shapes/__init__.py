"""Shapes of objects: a class a file, found by its ``shape``."""
