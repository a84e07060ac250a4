"""Command lines of a README: found in its code, and read by the parser of their package."""

import argparse
import importlib
import re
import shlex
import sys
from contextlib import redirect_stderr
from io import StringIO
from pathlib import Path
from unittest.mock import patch

import pytest

from drivers.base.command_line import Parser

CODE = re.compile(r"^```.*?\n(?P<block>.*?)^```|`(?P<inline>[^`\n]+)`", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"python -m (drivers|postproc|validation)\b.*")


def command_lines(readme: Path) -> list[str]:
    """Every ``python -m PACKAGE ...`` in code blocks and inline code, without comments, in order and once each."""
    found: dict[str, None] = {}
    for code in CODE.finditer(readme.read_text()):
        text = (code["block"] or code["inline"]).replace("\\\n", " ")
        for line in text.splitlines():
            for part in re.split(r" && | \|\| | ; ", line):
                if command := COMMAND.search(part):
                    found[command[0].partition(" # ")[0].strip()] = None
    return [*found]


def parse(line: str) -> argparse.Namespace:
    """Parses a command line with the parser of its package, and runs nothing.

    Raises:
        AssertionError: unknown command or option, or a wrong value, with the parser's message.
    """
    _, _, package, *words = shlex.split(line)
    module = importlib.import_module(f"{package}.__main__")
    parsed: list[argparse.Namespace] = []
    read = Parser.parse_args

    def parse_only(parser: Parser) -> argparse.Namespace:
        parsed.append(read(parser))
        raise SystemExit(0)

    arguments, environment = patch.object(sys, "argv", [package, *words]), patch.dict("os.environ")
    parser, message = patch.object(Parser, "parse_args", parse_only), StringIO()
    with arguments, environment, parser, redirect_stderr(message), pytest.raises(SystemExit):
        module.main()
    assert parsed, message.getvalue()
    return parsed[0]
