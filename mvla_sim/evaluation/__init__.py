"""Everything that looks at ground truth: rasterising it, scoring against it, tuning thresholds with it."""
