"""The twin: a simulated handheld with its own physics."""
