"""What accuracy costs: exact attainable sets, sampled ones, and solvers for distances, in the plane and in space."""
