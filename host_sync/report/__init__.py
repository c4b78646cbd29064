"""Reports: one file for the screen and one for paper."""
