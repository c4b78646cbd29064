"""Mosaics: overlapping presses of one object, stitched into one height map with its uncertainty."""
