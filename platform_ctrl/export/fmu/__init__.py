"""Plant and sampled controllers of a job as a functional mock-up unit (FMI 3.0, co-simulation)."""
