"""Distances from required wrenches to attainable sets, as the first edition measured them."""
