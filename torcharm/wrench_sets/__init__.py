"""Attainable sets: which wrenches pressures can provide at a node, and how far required wrenches are from them."""
