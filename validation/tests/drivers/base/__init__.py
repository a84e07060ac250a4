"""Tests of ``drivers/base`` and of options shared by all commands."""
