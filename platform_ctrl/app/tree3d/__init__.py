"""The gimbal tree in 3-D, turning with a simulated run: what the page's own script draws, and what it is told."""
