"""The workstation: offload, library, full calibration, full reconstruction, renders."""
