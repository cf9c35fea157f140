"""What accuracy costs: ways to sample attainable sets, and solvers for distances to them."""
