"""What accuracy costs: exact attainable sets, sampled ones, and solvers for distances to them, in the plane and in space."""
