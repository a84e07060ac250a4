"""Command lines of a README: found in its code, and read by the parser."""

import re
import shlex
from pathlib import Path
from typing import Any
from unittest.mock import patch

import click

from validation.commands.beads import BEADS

CODE = re.compile(r"^```.*?\n(?P<block>.*?)^```|`(?P<inline>[^`\n]+)`", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"beads (?=[a-z-]).*")


def command_lines(readme: Path) -> list[str]:
    """Every ``beads ...`` in code blocks and inline code, without comments, in order and once each."""
    found: dict[str, None] = {}
    for code in CODE.finditer(readme.read_text()):
        text = (code["block"] or code["inline"]).replace("\\\n", " ")
        for line in text.splitlines():
            for part in re.split(r" && | \|\| | ; ", line):
                if command := COMMAND.match(part):
                    found[command[0].partition(" # ")[0].strip()] = None
    return [*found]


def parse(line: str) -> dict[str, Any]:
    """Arguments of a command line by name; runs nothing.

    Raises:
        AssertionError: unknown command or option, or a wrong value, with the parser's message.
    """
    _, name, *words = shlex.split(line)
    with patch.dict("os.environ"):  # --engines changes it
        try:
            whole = BEADS.make_context("beads", [name])
            assert name in BEADS.commands, name
            return BEADS.commands[name].make_context(name, words, whole).params
        except click.exceptions.Exit:  # --help or --version
            return {}
        except click.UsageError as error:
            raise AssertionError(error.format_message()) from error
