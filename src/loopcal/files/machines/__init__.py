"""Machines, instruments and effects in files: schema, reader and writer."""
