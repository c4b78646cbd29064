"""Calibrations on the device, by instrument, gel and lights: slots, versions, rollback, import and export."""
