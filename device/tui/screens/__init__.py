"""The app and its screens."""
