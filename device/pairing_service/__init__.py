"""The listening side of pairing, and authorized keys."""
