"""The twin: one simulated handheld. Camera, lights, button and operator are thin views of one `bench`."""
