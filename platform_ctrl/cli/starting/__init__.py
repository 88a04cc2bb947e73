"""The files that ``platform-ctrl new`` writes: what a plant is for, the loops that this takes, and their text."""
