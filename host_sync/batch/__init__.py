"""Many scans by several processes: one scan a process at a time, and a process that dies costs nothing but its time."""
