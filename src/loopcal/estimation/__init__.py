"""From readings to parameters: problem, kernel, reduction, solver, result."""
