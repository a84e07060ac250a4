"""From a scene file to an engine's raw output: scene -> chain -> elements -> deck -> run."""
