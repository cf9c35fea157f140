"""How right the numbers are on stiff, degenerate and extreme scenes."""
