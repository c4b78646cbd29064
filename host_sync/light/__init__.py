"""The light of a gel sensor: one forward model of the intensity of every channel, its calibration and its inversion."""
