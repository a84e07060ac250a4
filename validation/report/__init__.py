"""The report: one page that stands alone, and the same checks as JSON."""
