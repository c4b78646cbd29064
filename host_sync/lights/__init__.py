"""Sensors of any number of lights: which three are read together, and which are left out where."""
