"""Whether a frame was made as its calibration was: pattern of the skin, levels and layout of the lights, sharpness."""
