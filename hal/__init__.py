"""The hardware layer: photons and currents. Camera, lights, button; real drivers and their twin."""
