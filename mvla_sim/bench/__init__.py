"""How cost grows: timed points of every stage, models fitted to them, and what a large campaign would take."""
