"""The pairing protocol, for both sides."""
