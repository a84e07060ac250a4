"""Kit of checks for an adapter, or a build of its code, before its first use."""
