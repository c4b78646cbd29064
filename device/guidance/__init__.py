"""Live guidance of a press."""
