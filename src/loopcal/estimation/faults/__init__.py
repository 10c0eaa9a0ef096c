"""Faults of whole files: found before a fit, from the nominal machine alone."""
