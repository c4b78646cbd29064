"""The instrument: the records it writes, calibration, quick look, scanning. Files directly here are portable."""
