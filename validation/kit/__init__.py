"""Kit: judges an adapter, or a build of its code, before anybody relies on it."""
