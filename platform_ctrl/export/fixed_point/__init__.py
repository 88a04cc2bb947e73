"""Controllers in integers, with the proof that nothing overflows."""
