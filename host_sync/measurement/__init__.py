"""Measurement: form, filters, parameters and what their ± is."""
