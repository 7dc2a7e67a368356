"""Trajectories of the sensor: a class a file, found by its ``kind``."""
