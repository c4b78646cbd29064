"""Held-out error, figures of the paper, reprocessing."""
