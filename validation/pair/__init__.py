"""Two runs against each other: what they are, what differs, by how much, since when, and whether that is allowed."""
