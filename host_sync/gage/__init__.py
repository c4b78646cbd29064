"""Gage repeatability and reproducibility."""
