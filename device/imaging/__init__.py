"""From raw counts to a flat-field-corrected image."""
