"""The instrument: records, calibration, quick look, acquisition, screens; CONTRIBUTING.md lists the portable rooms."""
