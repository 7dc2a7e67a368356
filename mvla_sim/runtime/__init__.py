"""What the program runs on: compute backend, ``doctor``, cache folder, progress and provenance."""
