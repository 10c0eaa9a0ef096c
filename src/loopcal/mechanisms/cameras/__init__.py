"""Cameras: lenses that project, and boards that they see."""
