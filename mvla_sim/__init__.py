"""mvla-sim: phase-free geometry reconstruction from radio channels."""

__version__ = "0.1.0"
