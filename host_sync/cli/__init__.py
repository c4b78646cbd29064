"""The commands of retrosync, one module for each family."""
