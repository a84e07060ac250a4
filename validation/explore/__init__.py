"""Live page of a scene: knobs, and the forces that follow them (``beads explore``)."""
