"""Tables of readings: what is in a file of any format, as columns of numbers with units."""
