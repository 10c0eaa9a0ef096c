"""Project files: schema, readings, noise, and what a run needs of them."""
