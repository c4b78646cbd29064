"""Registration of two presses of one object, with its own uncertainty, and their difference."""
