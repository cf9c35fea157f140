"""Workspaces: where antagonistic arms reach and arms of one kind do, with 0, 2 and 5 N, against brute force."""
