"""Settings of the machine that the instrument runs on: clock, network and brightness of the panel."""
