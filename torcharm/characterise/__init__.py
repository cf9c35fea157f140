"""From what a test bench wrote, or a data sheet's table, to force models and their files."""
