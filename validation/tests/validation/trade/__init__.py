"""Tests of ``validation.trade``."""
