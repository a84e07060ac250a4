"""What each modelling element adds and costs, what may be left out, and what the experiment would have shown."""
