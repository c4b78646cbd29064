"""From a frame to its slopes."""
