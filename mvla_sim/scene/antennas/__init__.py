"""Antenna patterns: a class a file, found by its ``kind``."""
