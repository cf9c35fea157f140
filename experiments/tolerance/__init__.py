"""Tolerances: which one decides the paper's arms, yields against a million plain samples, and a robust design."""
