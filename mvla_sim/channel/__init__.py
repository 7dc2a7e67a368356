"""From the world to channel impulse responses: ray tracing, the CIR dataset and its file."""
