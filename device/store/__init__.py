"""The device's own store: bundles, calibrations, gels, identity."""
