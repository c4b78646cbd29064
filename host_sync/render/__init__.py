"""Pictures of a relief: shading, error maps, level curves."""
