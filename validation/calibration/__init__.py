"""Calibration: the parameters of a scene that measured data ask for, and how surely the data tell them."""
