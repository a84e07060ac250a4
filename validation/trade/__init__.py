"""Error against computing time of every engine and time step, and the cheapest way to an accuracy."""
