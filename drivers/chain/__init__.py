"""Scene -> Case: the chain as arrays, its contact law, its modelling elements, its trace."""
