"""Areal surface parameters of ISO 25178-2."""
