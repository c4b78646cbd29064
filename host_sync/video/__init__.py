"""Sequences of frames: heights of every frame, and the movie."""
