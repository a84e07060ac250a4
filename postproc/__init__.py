"""From force traces to sensor averages, peaks, speeds and widths, and to figures; knows no engine."""
