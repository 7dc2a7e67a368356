"""Kinds of noise, a module each."""
