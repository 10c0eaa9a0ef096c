"""The history of a machine on the disk."""
