"""The same spot again: what changed on an object between two presses, and how sure that is."""
