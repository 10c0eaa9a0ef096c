"""Begin a project from files of readings: recognise, place, state, write."""
