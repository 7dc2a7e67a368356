"""Peak detectors, a module each."""
