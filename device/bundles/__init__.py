"""The records on disk that both sides read: scan and calibration bundles, raw frames, receipts."""
