"""Numbers, units and tables as people read them; the same in every output."""
