"""The instrument's screens in a terminal."""
