"""The way out: controllers and plants as C, FMU, MJCF, MATLAB data, JSON and CSV."""
