"""Instruments, composable with any machine: see `loopcal.mechanisms.machine`."""
