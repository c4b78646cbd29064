"""Judges an instrument by certified specimens, and writes its calibration certificate."""
