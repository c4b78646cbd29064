"""Comparison of one spot: what changed on an object between two presses, and how sure that is."""
