"""Gradient fields, height maps and the Poisson solver by cosine transform."""
