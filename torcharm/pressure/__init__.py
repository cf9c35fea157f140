"""Pressures: the error that is predicted, the search, its baseline, and fits in wrenches."""
