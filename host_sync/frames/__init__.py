"""Images of any camera, frame sets and sequences."""
