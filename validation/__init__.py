"""How far each number is from an independent reference, and what that accuracy cost."""
