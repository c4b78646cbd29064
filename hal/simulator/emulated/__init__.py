"""Emulated chips, lines and camera stack on which the real drivers run."""
