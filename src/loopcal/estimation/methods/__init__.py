"""Methods of estimation: what a method is, one module for each, and their registry."""
