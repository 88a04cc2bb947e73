"""Design from measured frequency responses: a MIMO PID under limits at every frequency."""
