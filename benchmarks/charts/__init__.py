"""Speed against accuracy: one chart per family, its Pareto front and the default on it."""
