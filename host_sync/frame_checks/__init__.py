"""Checks that a frame was made as its calibration was: pattern of the skin, levels and layout of lights, sharpness."""
