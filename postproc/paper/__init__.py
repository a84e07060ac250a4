"""Theory, simulations and quoted numbers behind the paper's figures."""
