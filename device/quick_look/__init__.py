"""The reduced height map made on the handheld, and its files."""
