"""One self-contained HTML page that says what a calibration found and how far to trust it."""
