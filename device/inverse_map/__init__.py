"""The map from colour and position to slope: the model, not its fitting."""
