"""Fits the inverse map to balls and judges the fit."""
