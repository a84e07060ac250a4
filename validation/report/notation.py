"""One notation of numbers on the whole page."""

import re
from decimal import Decimal

from markupsafe import Markup, escape

SMALLEST, LARGEST = Decimal("1e-3"), Decimal("1e6")  # numbers from the one to below the other are decimals
# an exponent, a decimal with three zeros behind the point, or a zero with a sign
NUMBER = re.compile(r"(?<![\w.])[+-]?(?:\d+(?:\.\d+)?e[+-]?\d+|0\.000\d+|(?<=[+-])0\.0+)(?![\w.]*\w)")
VERBATIM = re.compile(r"(<(script|style|pre|code|q|title)\b.*?</\2>|<[^>]*>)", re.DOTALL)  # and tags
POWER = re.compile(r"\d[\d.]*e-?\d+")  # number with a power of ten


def one_notation(page: str) -> str:
    """Page with all numbers in its text in one notation; quotes, code, scripts and attributes stay as they are."""
    parts = VERBATIM.split(page)  # a text, its separator and the separator's tag, in turn
    parts[::3] = [NUMBER.sub(lambda found: plain_number(found[0]), text) for text in parts[::3]]
    del parts[2::3]
    return "".join(parts)


def plain_number(text: str) -> str:
    """Number with the same digits: 5.1e-11 if small or large, else 0.014; 0 for a zero with an exponent.

    A positive number keeps its sign; a zero has none.
    """
    value = Decimal(text)
    if not value:
        return "0" if "e" in text else text.lstrip("+-")
    sign = "+" if text.startswith("+") else ""
    if SMALLEST <= abs(value) < LARGEST:
        return f"{sign}{value:f}"
    digits = "".join(map(str, value.as_tuple().digits))
    mantissa = f"{digits[0]}.{digits[1:]}".rstrip(".")
    return f"{sign}{'-' * (value < 0)}{mantissa}e{value.adjusted()}"


def unbroken(text: str) -> Markup:
    """Text whose numbers with a power of ten are kept on one line."""
    return Markup(POWER.sub(r'<span class="number">\g<0></span>', str(escape(text))))
