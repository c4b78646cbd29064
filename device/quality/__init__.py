"""Checks of a press, its lights and the gel."""
