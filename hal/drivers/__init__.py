"""Drivers of real hardware."""
