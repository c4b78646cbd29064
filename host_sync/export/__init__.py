"""Exports of scans and results for other programs; one writer per format."""
