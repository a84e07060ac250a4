"""Comparison of results with independent references, and the cost of their accuracy.

For notebooks and scripts (see ``postproc/README.md``): ``plan``, ``assess``, ``fit``, ``predict``, ``design``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from validation.accuracy.budget import assess
    from validation.accuracy.plan import plan
    from validation.calibration.command import fit
    from validation.calibration.design import design
    from validation.calibration.predict import predict

__all__ = ["assess", "design", "fit", "plan", "predict"]
EXPORTS = {
    "assess": "validation.accuracy.budget",
    "plan": "validation.accuracy.plan",
    "fit": "validation.calibration.command",
    "predict": "validation.calibration.predict",
    "design": "validation.calibration.design",
}


def __getattr__(name: str) -> Any:
    """Import an exported function when it is first used, so that command lines start fast."""
    if name not in EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(EXPORTS[name]), name)
