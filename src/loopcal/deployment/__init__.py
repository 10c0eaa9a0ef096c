"""From a result back to the machine: what its controller can be told."""
