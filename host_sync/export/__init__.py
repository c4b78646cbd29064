"""One writer a format: scans and results in the files that other programs open."""
