"""The hardware layer: camera, lights, button; real drivers and their twin."""
