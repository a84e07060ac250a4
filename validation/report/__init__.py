"""The report: one page that stands alone, and the same verdicts as JSON and as JUnit XML."""
