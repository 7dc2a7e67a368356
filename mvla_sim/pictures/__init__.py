"""Picture files of what is stored: what is missing is computed here, and drawn by :mod:`mvla_sim.plot`."""
