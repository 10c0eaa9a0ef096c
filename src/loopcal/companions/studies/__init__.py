"""Monte Carlo studies: the same experiment many times, and what methods make of it."""
