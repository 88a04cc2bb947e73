"""Controllers of fixed structure: PID, observers of fixed order, static gains, tuned on the worst of several plants."""
