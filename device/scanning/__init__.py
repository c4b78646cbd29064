"""What touches the instrument: capture, the scanner, guided calibration."""
