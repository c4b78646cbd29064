"""Profiles: lines, step heights and parameters."""
