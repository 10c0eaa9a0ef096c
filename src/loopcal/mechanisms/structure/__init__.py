"""The structured model error: what every machine may have beyond geometry, with learnt scales."""
