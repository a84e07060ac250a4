"""The report: one page that stands alone, and the same verdicts as JSON and as JUnit XML."""

from validation.report.write_report import write_report

__all__ = ["write_report"]
