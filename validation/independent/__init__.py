"""Cases beyond the paper, judged by numbers that no engine here has made: published ones, closed forms, exact waves."""
