"""Wavelet shrinkage of frames: pixel noise taken out of intensity before slopes are read."""
