"""One frame becomes one result."""
