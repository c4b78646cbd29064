"""Detection of calibration spheres and of their contact."""
