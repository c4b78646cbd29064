"""Lights: where lamps stand and what they show; of any number of them, which three are read together where."""
