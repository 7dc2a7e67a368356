"""Rules that choose thresholds without the truth, a module each."""
