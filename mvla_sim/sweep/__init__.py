"""Many cases: the plan of an experiment and its execution."""
