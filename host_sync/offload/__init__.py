"""Fetching scans from a device, a card or a folder, and proving that they arrived whole."""
