"""The commands of `retroscan`, one module per family."""
