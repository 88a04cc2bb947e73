"""Magnus's mechanics: the matrices, the equations of motion, linear models, precession; the same in symbols."""
