"""Distances from required wrenches to attainable sets."""
