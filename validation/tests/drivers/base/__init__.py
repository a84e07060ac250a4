"""Tests of ``drivers/base`` and of what all commands share."""
