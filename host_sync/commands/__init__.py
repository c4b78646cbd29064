"""What the commands of `retrosync` do with their arguments, by theme; `host_sync.__main__` gathers them."""
