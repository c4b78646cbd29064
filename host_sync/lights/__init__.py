"""Lights: their places and directions; of any number of them, which three are read together where."""
