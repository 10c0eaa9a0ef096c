"""Readings that a mechanism would give: poses, true values, and noise of a known seed."""
