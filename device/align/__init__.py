"""Shift and turn between two presses: the coarse search that guidance, registration and mosaics refine."""
