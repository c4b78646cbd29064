"""The press coach: what the live stream says of contact, tilt, motion and depth, ten times a second and more."""
