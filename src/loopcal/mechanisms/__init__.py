"""Machines as loops: what is read, what is constant, and the equations that close."""
