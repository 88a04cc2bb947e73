"""Controllers as C99 source: one step, section by section, without library, allocation or loop."""
