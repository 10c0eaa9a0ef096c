"""What was measured: readings, their uncertainty, and whether they look right."""
