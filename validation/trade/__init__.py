"""What accuracy costs: errors against time for every engine and step, what else users do, and what to use."""
