"""The equations in symbols, the paper's number by number. SymPy is loaded when they are derived."""
