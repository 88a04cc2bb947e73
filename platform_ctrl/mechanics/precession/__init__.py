"""Precession theory (15): whether it may be used, what cures it, how far it is from the full equations."""
