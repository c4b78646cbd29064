"""From hardware to a proven frame, a scan, a calibration."""
