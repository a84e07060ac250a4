"""Trace -> numbers: gauges, peaks, speeds, widths, residuals."""
