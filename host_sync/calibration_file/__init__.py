"""Calibrations as files: kept, found again by what they were made from, and refused when they are not sound."""
