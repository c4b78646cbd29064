"""Durable files and folders, access to folders that others control, and sentences for the system's errors."""
