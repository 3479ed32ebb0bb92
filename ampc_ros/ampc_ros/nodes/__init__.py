"""Controller node and planner node."""
