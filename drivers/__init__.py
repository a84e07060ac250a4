"""From a scene file to an engine's raw output: scene -> chain -> elements -> deck -> run.

For notebooks and scripts (see ``postproc/README.md``): ``run_scene``, ``open_run``, ``explore``,
``read_study_table``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.interactive import explore, open_run, read_study_table, run_scene

__all__ = ["explore", "open_run", "read_study_table", "run_scene"]


def __getattr__(name: str) -> Any:
    """Import an exported function when it is first used, so that command lines start fast."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module("drivers.interactive"), name)
