"""How fast the evaluator is, how that grows, and against what."""
