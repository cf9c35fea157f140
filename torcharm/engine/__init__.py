"""The engine: every iteration of the library, written once, one element after the other, as machine code."""
