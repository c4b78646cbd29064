"""Full calibration: reflectance maps, spherical harmonics, lookup table (paper, section 5.1), report."""
