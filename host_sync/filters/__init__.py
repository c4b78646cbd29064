"""Form removal and filters before a measurement."""
