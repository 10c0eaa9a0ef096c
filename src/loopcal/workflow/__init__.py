"""The single path behind command line and app: everything a user asks for, end to end."""
