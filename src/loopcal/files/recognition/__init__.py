"""Recognise what a file of readings holds from its headers and values."""
