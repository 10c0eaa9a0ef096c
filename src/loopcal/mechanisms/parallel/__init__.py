"""Parallel machines: platforms on legs, whose passive joints need no sensor.

One scheme of names for all: a1_x ... are the coordinates of the joints of the base, b1_x ... of
the platform's in its own frame, QUANTITY_offset is added to what QUANTITY reads, and platform_x
... are the coordinates of the platform, which no sensor reads. A leg whose passive joint is not
read closes by its length alone; where the joint is read, by its coordinates.
"""
