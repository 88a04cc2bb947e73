"""Controllers as C99 source: one step of sections that are written out, without library, allocation or loop."""
