"""Cameras from nothing: where they stand, what they see, and which mistakes the files contain."""
