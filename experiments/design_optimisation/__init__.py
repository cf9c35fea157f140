"""Design optimisation by gradient: how good, how fast, and whether the shape gets better with the metric."""
