"""Search by likeness: which surfaces of a library look like a given one."""
