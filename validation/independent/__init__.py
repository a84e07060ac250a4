"""Cases beyond the paper, judged by published numbers, closed forms and exact waves, independent of all engines."""
