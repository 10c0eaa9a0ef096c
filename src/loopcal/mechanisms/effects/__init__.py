"""What geometry does not explain, as changes of what readings and parameters mean in a pose."""
