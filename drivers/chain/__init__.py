"""Scene -> Case: the chain as arrays, the contact law, the modelling elements and the trace of a run."""
