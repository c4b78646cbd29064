"""Full calibration on the workstation."""
