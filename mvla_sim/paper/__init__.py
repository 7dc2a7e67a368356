"""All that knows the paper: its claims, their averages and checks, its figures, the report."""
