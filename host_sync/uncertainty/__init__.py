"""Slope error model and Monte-Carlo height error."""
