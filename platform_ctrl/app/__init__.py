"""The designer: a page in the browser on which loops are shaped by hand, and what it works out behind it."""
