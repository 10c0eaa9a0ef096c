"""What a loop equation is and how it is evaluated: trace, tape, derivative, engine."""
