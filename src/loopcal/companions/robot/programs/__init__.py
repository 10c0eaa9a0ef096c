"""Robot programs, whose targets are edited in place."""
