"""From force traces to sensor averages, peaks, speeds and widths, and to figures; knows no engine.

For notebooks and scripts (see ``postproc/README.md``): ``observe``, ``errors``, ``forces``, ``gauges``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from postproc.read.run_tables import errors, forces, gauges, observe

__all__ = ["errors", "forces", "gauges", "observe"]


def __getattr__(name: str) -> Any:
    """Import an exported function when it is first used, so that command lines start fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("postproc.read.run_tables"), name)
