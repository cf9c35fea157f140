"""Sweeps: ten million designs of the antagonistic arm, what that costs, and whether descents find as good ones."""
