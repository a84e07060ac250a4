"""Linear theory of a chain, and spectra of runs."""
