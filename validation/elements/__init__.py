"""Effect and cost of each modelling element, and its share in the gap between elastic theory and experiment."""
