"""Published numbers against computed ones: the paper's statements, and cases beyond the paper."""
