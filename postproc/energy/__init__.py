"""Energy of each body and contact of a run: table, picture, and shares of ranges of bodies."""
