"""Report of a calibration: record, figures and summary."""
